"""How well a session went, as figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from g1stream.recording.channels import CHANNELS
from g1stream.recording.streams import Measured, Reference
from g1stream.report.messages import MessageStats, Percentiles, message_stats
from g1stream.report.metrics import Tracking, by_group, compare, pooled, track
from g1stream.report.text import render
from g1stream.robot.joints import JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.recording.session import Session
    from g1stream.report.metrics import Comparison

__all__ = ["LoopFigures", "Summary", "loop_figures", "render", "summarise"]


@dataclass(frozen=True)
class LoopFigures:
    """What the streamer counted; None for what it did not tell.

    Attributes:
        reason: why it ended early; empty when the motion was played to its end.
        commands: LowCmds written.
        rate, nominal_rate: achieved and asked for, Hz.
        lateness: of each write against its deadline.
        skipped: ticks left out because they were a whole period late or more.
        clamped: joint -> ticks at which its target was held at its limit, where that happened.
    """

    reason: str | None
    commands: int | None
    rate: float | None
    nominal_rate: float | None
    lateness: Percentiles | None
    skipped: int | None
    clamped: dict[str, int] | None

    def as_dict(self) -> dict[str, Any]:
        """The figures as JSON values."""
        return {
            "reason": self.reason,
            "commands": self.commands,
            "rate_hz": self.rate,
            "nominal_rate_hz": self.nominal_rate,
            "lateness_us": self.lateness and self.lateness._asdict(),
            "skipped_ticks": self.skipped,
            "clamped_ticks": self.clamped,
        }


@dataclass(frozen=True)
class Summary:
    """How well a session went; None for what was not recorded.

    Attributes:
        session: the file's name.
        motion: the motion's name.
        states: LowStates compared with the reference.
        duration: s of the motion over which they were.
        tracking: how closely the robot followed.
        loop: how the streamer kept its deadlines.
        counts: messages by topic of the file.
        missing: by topic, samples that their own numbers say were published and did not come.
        streams: by topic, how the samples of the wire came.
        notes: sentences that the figures must be read with.
    """

    session: str
    motion: str | None
    states: int
    duration: float
    tracking: Tracking | None
    loop: LoopFigures | None
    counts: dict[str, int]
    missing: dict[str, int] | None
    streams: dict[str, MessageStats]
    notes: list[str]

    def as_dict(self) -> dict[str, Any]:
        """The summary as JSON values, joints and limbs by name; units are in the keys."""
        return {
            "session": self.session,
            "motion": self.motion,
            "compared_states": self.states,
            "compared_s": self.duration,
            "tracking": self.tracking and _tracking_dict(self.tracking),
            "loop": self.loop and self.loop.as_dict(),
            "counts": self.counts,
            "missing": self.missing,
            "streams": {topic: stats.as_dict() for topic, stats in self.streams.items()},
            "notes": self.notes,
        }


def summarise(session: Session) -> Summary:
    """Compare, count and collect what a session says of itself.

    Raises:
        RecordingError: the file is damaged.
    """
    counts = {topic: n for topic, n in sorted(session.topics.items()) if n}
    stats = {t: message_stats(s) for t, s in session.times.items() if _is_of_the_wire(t)}
    compared = None
    if Reference.topic in counts and Measured.topic in counts:
        compared = compare(session.reference, session.measured)
    states = len(compared.time) if compared else 0
    metadata = session.metadata
    return Summary(
        session=session.path.name,
        motion=(metadata.get("motion") or {}).get("name"),
        states=states,
        duration=compared.duration if compared else 0.0,
        tracking=track(compared) if compared and states else None,
        loop=loop_figures(metadata["stream"]) if metadata.get("stream") else None,
        counts=counts,
        missing=(metadata.get("recorder") or {}).get("missing"),
        streams=stats,
        notes=_notes(session, compared, stats),
    )


def _is_of_the_wire(topic: str) -> bool:
    """Whether a topic has samples as they were on the wire; other messages follow from those."""
    channel = CHANNELS.get(topic)
    return channel is not None and channel.source is not None


def loop_figures(told: Mapping[str, Any]) -> LoopFigures:
    """What the streamer counted, from the metadata that it leaves."""
    lateness, clamped = told.get("lateness_us") or {}, told.get("clamped_ticks")
    keys = ("p50", "p99", "p99.9", "max")
    return LoopFigures(
        reason=told.get("reason"),
        commands=told.get("commands"),
        rate=told.get("rate_hz"),
        nominal_rate=told.get("nominal_rate_hz"),
        lateness=Percentiles(*map(lateness.get, keys)) if lateness.keys() >= set(keys) else None,
        skipped=told.get("skipped_ticks"),
        clamped=None
        if clamped is None
        else {name: n for name, n in zip(JOINT_NAMES, clamped, strict=True) if n},
    )


def _notes(
    session: Session, compared: Comparison | None, stats: Mapping[str, MessageStats]
) -> list[str]:
    notes = []
    if not session.complete:
        notes.append("The file was not closed by its recorder; it ends with its last whole chunk.")
    if compared is None:
        absent = [t for t in (Reference.topic, Measured.topic) if not session.topics.get(t)]
        notes.append(f"There is nothing to compare: no messages on {' and '.join(absent)}.")
    elif not len(compared.time):
        notes.append("There is nothing to compare: no state came while the motion was played.")
    if compared and compared.left_out:
        notes.append(
            f"States left out, because they fell into holes of the reference: {compared.left_out}."
        )
    off = [f"{t} by {-s.clock_offset:+.3f} s" for t, s in stats.items() if s.clock_offset]
    if off:
        notes.append(
            f"Stamps are off the recorder's clock: {', '.join(off)}. To compare, they are set "
            "right to within the latency."
        )
    return notes


def _tracking_dict(tracking: Tracking) -> dict[str, Any]:
    rmse, delay = tracking.rmse, tracking.delay
    worst = int(rmse.argmax())
    return {
        "rmse_rad": pooled(rmse),
        "rmse_rad_by_group": by_group(rmse),
        "worst_joint": JOINT_NAMES[worst],
        "delay_s": delay and delay.seconds,
        "rmse_rad_without_delay": delay and pooled(delay.rmse),
        "rmse_rad_without_delay_and_mean": delay and pooled(delay.std),
        "joints": {
            name: {
                "rmse_rad": float(tracking.rmse[i]),
                "mean_rad": float(tracking.mean[i]),
                "max_abs_rad": float(tracking.max_abs[i]),
                "max_abs_at_s": float(tracking.max_abs_at[i]),
            }
            for i, name in enumerate(JOINT_NAMES)
        },
    }
