"""How a motion was played."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

from g1stream.robot.joints import by_joint

if TYPE_CHECKING:
    from g1stream.control.loop import LoopReport
    from g1stream.doctor.facts import Finding
    from g1stream.motion.limits import Interval
    from g1stream.realtime import Grant

__all__ = ["StreamOutcome", "loop_summary"]

_PERCENTILES: Final = (50.0, 99.0, 99.9)


@dataclass(frozen=True)
class StreamOutcome:
    """How a motion was played.

    Attributes:
        motion: its name.
        report: what the loop counted.
        recording: the recorder's own summary; None where nothing was recorded.
        wire: what was lost on the wire and what was not.
        granted: what the system granted to be on time.
        interval: what of the motion was to be played.
        findings: where no command was sent, the reasons as far as they can be seen.
    """

    motion: str
    report: LoopReport
    recording: dict[str, Any] | None
    wire: dict[str, int | None]
    granted: list[Grant]
    interval: Interval
    findings: list[Finding] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """The outcome as JSON values."""
        return {
            "motion": self.motion,
            "interval_s": asdict(self.interval),
            "recording": self.recording,
            "wire": self.wire,
            "realtime": [asdict(grant) for grant in self.granted],
            "findings": [finding.model_dump(mode="json") for finding in self.findings],
            "loop": loop_summary(self.report),  # last, as it ends with the longest of all
        }


def loop_summary(report: LoopReport) -> dict[str, Any]:
    """What the loop counted, as JSON values."""
    lateness = report.lateness
    return {
        "reason": report.reason,
        "commands": report.commands,
        "rate_hz": report.rate if report.commands > 1 else None,
        "nominal_rate_hz": 1e9 / report.period,
        "lateness_us": {
            **{f"p{p:g}": lateness.percentile_us(p) for p in _PERCENTILES if lateness.n},
            "max": lateness.maximum_ns / 1000.0,
        },
        "skipped_ticks": report.skipped,
        "worst_work_us": report.worst_work / 1000.0,
        "states": report.states,
        "feedforward": report.feedforward,
        "support": report.support or None,
        "feedforward_events": [change._asdict() for change in report.feedforward_changes],
        "clamped_joints": by_joint(report.clamped.tolist()),
        "saturated_joints": by_joint(report.saturated.tolist()),
        "clamped_ticks": report.clamped.tolist(),
        "saturated_ticks": report.saturated.tolist(),
        "lateness_histogram_us": lateness.sparse(),
    }
