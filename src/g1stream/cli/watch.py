"""Shows how a loop goes, from a thread beside it that the loop never waits for."""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING

from g1stream.control.phases import Phase

if TYPE_CHECKING:
    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion

__all__ = ["watch"]

_PERIOD_S = 0.2
_BAR = 30


def watch(loop: StreamLoop, motion: Motion) -> None:
    """Print events as lines and, on a terminal, a progress bar; on standard error."""
    threading.Thread(target=_watch, args=(loop, motion), daemon=True).start()


def _watch(loop: StreamLoop, motion: Motion) -> None:
    shows_bar = sys.stderr.isatty()
    while True:
        done = loop.state.phase is Phase.DONE
        clear = "\r\x1b[K" if shows_bar else ""
        while loop.events:
            _, text = loop.events.popleft()
            _write(f"{clear}{text}\n")
        if done:
            return
        if shows_bar:
            _write(f"{clear}{_bar(loop, motion)}")
        time.sleep(_PERIOD_S)


def _bar(loop: StreamLoop, motion: Motion) -> str:
    part = min(1.0, loop.motion_time / motion.duration) if motion.duration else 1.0
    filled = round(part * _BAR)
    late = loop.report.lateness.maximum_ns / 1e6
    return (
        f"{loop.state.phase.name:<5} [{'#' * filled}{'.' * (_BAR - filled)}] "
        f"{loop.motion_time:6.1f} / {motion.duration:.1f} s   worst lateness {late:.2f} ms"
    )


def _write(text: str) -> None:
    # A closed pipe or terminal must not end what it only shows.
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:
        return
