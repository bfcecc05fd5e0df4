"""What is in a session file, and how well it went, as figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from g1stream.analysis.health import problems
from g1stream.analysis.loop import loop_figures
from g1stream.analysis.message_stats import stats_by_topic
from g1stream.analysis.metrics import track
from g1stream.analysis.termination import ending, part
from g1stream.analysis.tracking import comparison

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.analysis.loop import LoopFigures
    from g1stream.analysis.message_stats import MessageStats
    from g1stream.analysis.metrics import Tracking
    from g1stream.analysis.termination import Ending
    from g1stream.session.session import Session
    from g1stream.session.summary import PhaseInterval

__all__ = ["FEEDFORWARD", "Info", "describe"]

FEEDFORWARD: Final = "feed-forward: "
"""What the streamer logs of its feed-forward begins with this."""


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
        ending: how it ended.
        settings: those that were not the defaults, keyed like `stream.rate`.
        gains: (lowest, highest) of kp in Nm/rad and of kd in Nm s/rad.
        loop: what commands carried, and how the streamer kept its deadlines.
        feedforward_log: what the streamer logged of its feed-forward, also one that was killed.
        tracking: how closely the robot followed while the motion was played.
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
    phases: list[PhaseInterval]
    ending: Ending
    settings: dict[str, Any] | None
    gains: dict[str, tuple[float, float]] | None
    loop: LoopFigures | None
    feedforward_log: list[str]
    tracking: Tracking | None
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
                {"phase": span.phase.name, "duration_s": span.duration_s} for span in self.phases
            ],
            "ending": self.ending.as_dict(),
            "settings": self.settings,
            "gains": self.gains,
            "loop": self.loop and self.loop.as_dict(),
            "feedforward_log": self.feedforward_log,
            "tracking": self.tracking and self.tracking.as_dict(),
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
    told, recorder = metadata.get("stream"), metadata.get("recorder") or {}
    streams, loop = stats_by_topic(times), loop_figures(told) if told else None
    spans, compared = session.phases, comparison(session)
    ended = ending(session, spans)
    return Info(
        files={str(path): path.stat().st_size for path in session.paths},
        complete=session.complete,
        first=min(int(stream.log_time.min()) for stream in times.values()),
        last=max(int(stream.log_time.max()) for stream in times.values()),
        host=metadata.get("host"),
        domain=metadata.get("domain"),
        interface=metadata.get("interface"),
        versions={"g1stream": metadata.get("g1stream", "?"), **metadata.get("versions", {})},
        motion=part(metadata, "motion") or None,
        phases=spans,
        ending=ended,
        settings=_settings(metadata.get("config")),
        gains=_gains(metadata.get("gains")),
        loop=loop,
        feedforward_log=[e.text for e in session.log if e.text.startswith(FEEDFORWARD)],
        tracking=track(compared) if compared and len(compared.time) else None,
        counts=dict(sorted(session.topics.items())),
        streams=streams,
        missing=recorder.get("missing"),
        absent=recorder.get("absent", []),
        attachments={name: len(data) for name, data in session.attachments.items()},
        problems=problems(session, ended, loop, streams),
    )


def _settings(config: Any) -> dict[str, Any] | None:
    if not isinstance(config, dict):
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
