"""What the streamer of a session counted, as it told the recorder at its end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from g1stream.analysis.message_stats import PERCENTILE_NAMES, Percentiles
from g1stream.robot.joints import by_joint

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["LoopFigures", "loop_figures"]


@dataclass(frozen=True)
class LoopFigures:
    """What the streamer counted; None for what it did not tell.

    Attributes:
        reason: why it ended early; empty when it ended as asked.
        commands: LowCmds written.
        rate, nominal_rate: achieved and asked for, Hz.
        lateness: of each write against its deadline.
        skipped: ticks left out because they were a whole period late or more.
        clamped: joint -> ticks at which its target was held at its limit, where that happened.
        feedforward: what commands carried beside the position, at first: velocity, or dynamics,
            which is velocity and torque.
        support: how the robot was taken to be held, for the torque.
        feedforward_events: when the torque went or came back: motion_time in s, kind, reason.
        saturated: joint -> ticks at which its feed-forward torque was held at its limit.
    """

    reason: str | None
    commands: int | None
    rate: float | None
    nominal_rate: float | None
    lateness: Percentiles | None
    skipped: int | None
    clamped: dict[str, int] | None
    feedforward: str | None
    support: str | None
    feedforward_events: list[dict[str, Any]]
    saturated: dict[str, int] | None

    def as_dict(self) -> dict[str, Any]:
        """The figures as JSON values."""
        return {
            "reason": self.reason,
            "commands": self.commands,
            "rate_hz": self.rate,
            "nominal_rate_hz": self.nominal_rate,
            "lateness_us": self.lateness and self.lateness.as_dict(),
            "skipped_ticks": self.skipped,
            "clamped_ticks": self.clamped,
            "feedforward": self.feedforward,
            "support": self.support,
            "feedforward_events": self.feedforward_events,
            "saturated_ticks": self.saturated,
        }


def loop_figures(told: Mapping[str, Any]) -> LoopFigures:
    """What the streamer counted, from the metadata that it leaves."""
    lateness = told.get("lateness_us") or {}
    known = lateness.keys() >= set(PERCENTILE_NAMES)
    return LoopFigures(
        reason=told.get("reason"),
        commands=told.get("commands"),
        rate=told.get("rate_hz"),
        nominal_rate=told.get("nominal_rate_hz"),
        lateness=Percentiles(*map(lateness.get, PERCENTILE_NAMES)) if known else None,
        skipped=told.get("skipped_ticks"),
        clamped=_held(told.get("clamped_ticks")),
        feedforward=told.get("feedforward") or None,
        support=told.get("support") or None,
        feedforward_events=told.get("feedforward_events") or [],
        saturated=_held(told.get("saturated_ticks")),
    )


def _held(ticks: Sequence[int] | None) -> dict[str, int] | None:
    return None if ticks is None else by_joint(ticks)
