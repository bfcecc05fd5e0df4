"""What of a session is not as it should be, a sentence each."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from g1stream.analysis.formatting import most
from g1stream.session.streams import STREAMS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.analysis.loop import LoopFigures
    from g1stream.analysis.message_stats import MessageStats
    from g1stream.analysis.termination import Ending
    from g1stream.session.session import Session

__all__ = ["problems"]


def problems(
    session: Session, ending: Ending, loop: LoopFigures | None, streams: Mapping[str, MessageStats]
) -> list[str]:
    """What is not as it should be, what matters most first.

    Args:
        session: whose metadata and log tell.
        ending: how it ended.
        loop: what the streamer counted.
        streams: by topic, how its messages came.
    """
    recorder = session.metadata.get("recorder")
    return [
        *_vanished(ending),
        *_files(session),
        *_recorder(recorder or {}, told=recorder is not None),
        *_streams(streams),
        *(_loop(loop) if loop else []),
        *_warnings(session),
    ]


def _vanished(ending: Ending) -> list[str]:
    if ending.vanished_in is None:
        return []
    return [
        f"The streamer vanished in {ending.vanished_in.name}, without DAMP: it was killed or cut "
        "off, and nobody damped the robot."
    ]


def _files(session: Session) -> list[str]:
    unreadable = session.unreadable_parts
    found = [
        f"Part {number} "
        + (f"cannot be read: {unreadable[number]}" if number in unreadable else "is not there.")
        for number in session.absent_parts
    ]
    if not (session.complete or session.absent_parts):
        found.append("The file was not closed by its recorder; it ends with its last whole chunk.")
    return found


def _recorder(recorder: Mapping[str, Any], *, told: bool) -> list[str]:
    found = [] if told else ["The recorder did not get to say what it missed."]
    if recorder.get("stopped"):
        found.append(f"The recorder stopped early: {recorder['stopped']}")
    found += [
        f"The recorder's clock was set by {step['step_ns'] / 1e9:+.3f} s."
        for step in recorder.get("clock", {}).get("steps", [])
    ]
    lost = [f"{topic} {n}" for topic, n in (recorder.get("missing") or {}).items() if n]
    if lost:
        found.append(f"Samples that never came: {', '.join(lost)}.")
    odd = [f"{topic} {n}" for topic, n in (recorder.get("malformed") or {}).items() if n]
    if odd:
        found.append(f"Samples that were not of their topic's type: {', '.join(odd)}.")
    if dropped := recorder.get("dropped_datagrams"):
        found.append(f"The kernel had no room for {dropped} datagrams that came.")
    return found


def _streams(streams: Mapping[str, MessageStats]) -> list[str]:
    """Of the topics of the wire; what is derived from them has what they have."""
    wire = {topic: stats for topic, stats in streams.items() if topic in STREAMS}
    gaps = [
        f"{topic} {stats.gaps} (longest {(stats.longest_interval or 0.0) * 1e3:.1f} ms)"
        for topic, stats in wire.items()
        if stats.gaps
    ]
    found = [f"Gaps: {', '.join(gaps)}."] if gaps else []
    found += [
        f"The clock that stamps {topic} is {-stats.clock_offset:+.3f} s off the recorder's."
        for topic, stats in wire.items()
        if stats.clock_offset
    ]
    return found


def _loop(loop: LoopFigures) -> list[str]:
    found = []
    if loop.skipped:
        found.append(f"The streamer skipped {loop.skipped} ticks.")
    if loop.reason:
        found.append(f"The streamer ended early: {loop.reason}.")
    if loop.clamped:
        found.append(f"Joint targets were held at their limits, ticks: {most(loop.clamped)}.")
    if loop.saturated:
        found.append(
            f"Feed-forward torques were held at their limits, ticks: {most(loop.saturated)}."
        )
    return found


def _warnings(session: Session) -> list[str]:
    """What programs warned of; what differs in its numbers only is told once, as it was last."""
    alike: dict[str, list[str]] = {}
    for event in session.log:
        if event.level in {"WARNING", "ERROR", "FATAL"}:
            text = f"{event.name}: {event.text}"
            alike.setdefault(re.sub(r"\d+", "#", text), []).append(text)
    return [
        texts[0] if len(texts) == 1 else f"{texts[-1]} (the last of {len(texts)} such)"
        for texts in alike.values()
    ]
