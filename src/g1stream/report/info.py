"""What is in a session file, as figures."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from g1stream.recording.session import STREAMS
from g1stream.recording.streams import Reference
from g1stream.report.messages import message_stats
from g1stream.report.spans import phase_spans
from g1stream.report.summary import loop_figures

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.recording.session import Session
    from g1stream.report.messages import MessageStats
    from g1stream.report.spans import Span
    from g1stream.report.summary import LoopFigures

__all__ = ["Info", "describe"]

#: Topics whose messages come when something happens: they have no rate and no gaps.
_EVENTS: Final = ("/log", "/robot_description", "/scene")


@dataclass(frozen=True)
class Info:
    """What is in a session file; None for what it does not tell.

    Attributes:
        files: its parts, oldest first, and their sizes in bytes.
        complete: whether all of it is there and was closed properly.
        first, last: log times of the first and the last message, ns since the epoch.
        host, domain, interface: where it was recorded.
        versions: of g1stream and the packages that recorded it.
        motion: name, fps, frames and sha256 of what was played.
        phases: in the order that they came.
        settings: those that were not the defaults, keyed like `stream.rate`.
        gains: (lowest, highest) of kp in Nm/rad and of kd in Nm s/rad.
        loop: how the streamer kept its deadlines.
        counts: messages by topic.
        streams: by topic, how they came.
        missing: by topic, samples that their own numbers say were published and did not come.
        absent: topics of the wire that nobody published.
        attachments: name -> size in bytes.
        problems: what is not as it should be, a sentence each.
    """

    files: dict[str, int]
    complete: bool
    first: int
    last: int
    host: str | None
    domain: int | None
    interface: str | None
    versions: dict[str, str]
    motion: dict[str, Any] | None
    phases: list[Span]
    settings: dict[str, Any] | None
    gains: dict[str, tuple[float, float]] | None
    loop: LoopFigures | None
    counts: dict[str, int]
    streams: dict[str, MessageStats]
    missing: dict[str, int] | None
    absent: list[str]
    attachments: dict[str, int]
    problems: list[str]

    @property
    def duration(self) -> float:
        """From the first message to the last, s."""
        return (self.last - self.first) / 1e9

    def as_dict(self) -> dict[str, Any]:
        """The findings as JSON values."""
        return {
            "files_bytes": self.files,
            "complete": self.complete,
            "first_ns": self.first,
            "last_ns": self.last,
            "duration_s": self.duration,
            "host": self.host,
            "domain": self.domain,
            "interface": self.interface,
            "versions": self.versions,
            "motion": self.motion,
            "phases": [
                {"phase": span.phase.name, "duration_s": span.seconds} for span in self.phases
            ],
            "settings": self.settings,
            "gains": self.gains,
            "loop": self.loop and self.loop.as_dict(),
            "counts": self.counts,
            "streams": {topic: stats.as_dict() for topic, stats in self.streams.items()},
            "missing": self.missing,
            "absent": self.absent,
            "attachments_bytes": self.attachments,
            "problems": self.problems,
        }


def describe(session: Session) -> Info:
    """Look through a session.

    Raises:
        RecordingError: the file is damaged.
    """
    metadata, times = session.metadata, session.times
    streams = {t: message_stats(stream) for t, stream in times.items() if t not in _EVENTS}
    told = metadata.get("stream")
    recorder = metadata.get("recorder") or {}
    info = Info(
        files={str(path): path.stat().st_size for path in session.paths},
        complete=session.complete,
        first=min(int(stream.log_time.min()) for stream in times.values()),
        last=max(int(stream.log_time.max()) for stream in times.values()),
        host=metadata.get("host"),
        domain=metadata.get("domain"),
        interface=metadata.get("interface"),
        versions={"g1stream": metadata.get("g1stream", "?"), **metadata.get("versions", {})},
        motion=metadata.get("motion"),
        phases=_phases(session),
        settings=_settings(metadata.get("config")),
        gains=_gains(metadata.get("gains")),
        loop=loop_figures(told) if told else None,
        counts=dict(sorted(session.topics.items())),
        streams=streams,
        missing=recorder.get("missing"),
        absent=recorder.get("absent", []),
        attachments={name: len(data) for name, data in session.attachments.items()},
        problems=[],
    )
    info.problems.extend(_problems(session, info))
    return info


def _phases(session: Session) -> list[Span]:
    """By the publish times of the references."""
    if not session.topics.get(Reference.topic):
        return []
    stamps = session.reference.publish_time
    return phase_spans((stamps - stamps[0]) / 1e9, session.reference.phase)


def _settings(config: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if config is None:
        return None
    from g1stream.config import Config

    return dict(_differences(config, Config().model_dump(mode="json"), ""))


def _differences(
    values: Mapping[str, Any], defaults: Mapping[str, Any], prefix: str
) -> list[tuple[str, Any]]:
    """(key, value) of what is not the default; a default unknown here was another version's."""
    found: list[tuple[str, Any]] = []
    for key, value in values.items():
        default = defaults.get(key)
        if isinstance(value, dict) and isinstance(default, dict):
            found += _differences(value, default, f"{prefix}{key}.")
        elif value != default:
            found.append((f"{prefix}{key}", value))
    return found


def _gains(gains: Mapping[str, list[float]] | None) -> dict[str, tuple[float, float]] | None:
    if gains is None:
        return None
    return {name: (min(values), max(values)) for name, values in gains.items()}


def _problems(session: Session, info: Info) -> list[str]:
    unreadable = session.unreadable_parts
    found = [
        f"Part {number} "
        + (f"cannot be read: {unreadable[number]}" if number in unreadable else "is not there.")
        for number in session.absent_parts
    ]
    if not (info.complete or session.absent_parts):
        found.append("The file was not closed by its recorder; it ends with its last whole chunk.")
    recorder = session.metadata.get("recorder")
    if recorder is None:
        found.append("The recorder did not get to say what it missed.")
        recorder = {}
    if recorder.get("stopped"):
        found.append(f"The recorder stopped early: {recorder['stopped']}")
    found += [
        f"The recorder's clock was set by {step['step_ns'] / 1e9:+.3f} s."
        for step in recorder.get("clock", {}).get("steps", [])
    ]
    lost = [f"{topic} {n}" for topic, n in (info.missing or {}).items() if n]
    if lost:
        found.append(f"Samples that never came: {', '.join(lost)}.")
    gaps = [
        f"{topic} {stats.gaps} (longest {(stats.longest_interval or 0.0) * 1e3:.1f} ms)"
        for topic, stats in info.streams.items()
        if stats.gaps and topic in STREAMS  # what is derived from them has theirs
    ]
    if gaps:
        found.append(f"Gaps: {', '.join(gaps)}.")
    found += [
        f"The clock that stamps {topic} is {-stats.clock_offset:+.3f} s off the recorder's."
        for topic, stats in info.streams.items()
        if stats.clock_offset
    ]
    if info.loop and info.loop.skipped:
        found.append(f"The streamer skipped {info.loop.skipped} ticks.")
    if info.loop and info.loop.reason:
        found.append(f"The streamer ended early: {info.loop.reason}.")
    return found + _warnings(session)


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
