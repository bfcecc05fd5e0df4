"""How well a session went, as figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from g1stream.analysis.loop import loop_figures
from g1stream.analysis.message_stats import stats_by_topic
from g1stream.analysis.metrics import track
from g1stream.analysis.termination import ending, part
from g1stream.analysis.text import render
from g1stream.analysis.tracking import comparison, nothing_compared
from g1stream.session.streams import STREAMS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.analysis.loop import LoopFigures
    from g1stream.analysis.message_stats import MessageStats
    from g1stream.analysis.metrics import Comparison, Tracking
    from g1stream.analysis.termination import Ending
    from g1stream.session.session import Session

__all__ = ["Summary", "render", "summarise"]


@dataclass(frozen=True)
class Summary:
    """How well a session went; None for what was not recorded.

    Attributes:
        session: the file, as it was given.
        motion: the motion's name.
        ending: how it ended.
        tracking: how closely the robot followed.
        loop: what commands carried, and how the streamer kept its deadlines.
        counts: messages by topic of the file.
        missing: by topic, samples that their own numbers say were published and did not come.
        streams: by topic, how its messages came.
        notes: sentences that the figures must be read with.
    """

    session: str
    motion: str | None
    ending: Ending
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
            "ending": self.ending.as_dict(),
            "tracking": self.tracking and self.tracking.as_dict(),
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
    metadata, stats, compared = session.metadata, stats_by_topic(session.times), comparison(session)
    return Summary(
        session=str(session.path),
        motion=part(metadata, "motion").get("name"),
        ending=ending(session, session.phases),
        tracking=track(compared) if compared and len(compared.time) else None,
        loop=loop_figures(metadata["stream"]) if metadata.get("stream") else None,
        counts={topic: n for topic, n in sorted(session.topics.items()) if n},
        missing=(metadata.get("recorder") or {}).get("missing"),
        streams=stats,
        notes=_notes(session, compared, stats),
    )


def _notes(
    session: Session, compared: Comparison | None, stats: Mapping[str, MessageStats]
) -> list[str]:
    notes = []
    if not session.complete:
        notes.append("The file was not closed by its recorder; it ends with its last whole chunk.")
    if nothing := nothing_compared(session, compared):
        notes.append(f"There is nothing to compare: {nothing}.")
    if compared and compared.left_out:
        notes.append(
            f"States left out, because they fell into holes of the reference: {compared.left_out}."
        )
    off = [
        f"{topic} by {-one.clock_offset:+.3f} s"
        for topic, one in stats.items()
        if one.clock_offset and topic in STREAMS  # what is derived from them has their stamps
    ]
    if off:
        notes.append(
            f"Stamps are off the recorder's clock: {', '.join(off)}. To compare, they are set "
            "right to within the latency."
        )
    return notes
