"""What is in a session file, as text for people: one screen."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.analysis.info import FEEDFORWARD
from g1stream.analysis.text import (
    line,
    loop_lines,
    message_table,
    tracking_lines,
    tracking_table,
)

if TYPE_CHECKING:
    from g1stream.analysis.info import Info

__all__ = ["render_info"]

_UNKNOWN: Final = "not recorded"
_MOST_PROBLEMS: Final = 8


def render_info(info: Info) -> str:
    """The findings as text without colour, lines of 100 columns at most."""
    paragraphs = [
        [
            line("session", _files(info)),
            line("recorded", _recorded(info)),
            line("motion", _motion(info)),
            line(
                "phases",
                ", ".join(f"{p.phase.name} {p.duration_s:.2f} s" for p in info.phases) or _UNKNOWN,
            ),
            line("ended", str(info.ending)),
            line("settings", _settings(info)),
            *(loop_lines(info.loop) if info.loop else [line("feedforward", _feedforward(info))]),
            *([line("absent", ", ".join(info.absent))] if info.absent else []),
            line("attached", ", ".join(f"{n} ({_size(b)})" for n, b in info.attachments.items())),
        ],
        tracking_table(info.tracking),
        tracking_lines(info.tracking),
        message_table(info.counts, info.streams),
        _health(info),
    ]
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)


def _files(info: Info) -> str:
    paths = [Path(path) for path in info.files]
    parts = f" to {paths[-1].name}, {len(paths)} parts" if len(paths) > 1 else ""
    state = "closed properly" if info.complete else "not closed"
    return f"{paths[0].name}{parts}, {_size(sum(info.files.values()))}, {state}"


def _recorded(info: Info) -> str:
    begun = datetime.fromtimestamp(info.first / 1e9, timezone.utc)
    parts = [f"{begun:%Y-%m-%d %H:%M:%S} UTC", f"{info.duration:.2f} s"]
    if info.host:
        parts.append(f"on {info.host}")
    if info.interface:
        parts.append(f"domain {info.domain} on {info.interface}")
    return ", ".join([*parts, f"by g1stream {info.versions['g1stream']}"])


def _motion(info: Info) -> str:
    if not info.motion:
        return _UNKNOWN
    name, frames, fps, sha256 = map(info.motion.get, ("name", "frames", "fps", "sha256"))
    return f"{name or '?'}, {frames or '?'} frames at {f'{fps:g}' if fps else '?'} fps" + (
        f", sha256 {sha256[:12]}" if sha256 else ""
    )


def _settings(info: Info) -> str:
    if info.settings is None:
        return _UNKNOWN
    changed = [f"{key} = {value}" for key, value in info.settings.items()]
    gains = [f"{name} {low:g} to {high:g}" for name, (low, high) in (info.gains or {}).items()]
    return "; ".join([*(changed or ["the defaults"]), *gains])


def _feedforward(info: Info) -> str:
    """What a streamer that did not get to count what it did had logged until then."""
    return "; ".join(text.removeprefix(FEEDFORWARD) for text in info.feedforward_log) or _UNKNOWN


def _health(info: Info) -> list[str]:
    told = info.problems[:_MOST_PROBLEMS] or ["nothing is amiss"]
    left = len(info.problems) - _MOST_PROBLEMS
    if left > 0:
        told.append(f"and {left} more; --json lists them all")
    return [line("" if i else "health", text) for i, text in enumerate(told)]


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:.1f} MB" if n_bytes >= 1e5 else f"{n_bytes / 1e3:.1f} kB"
