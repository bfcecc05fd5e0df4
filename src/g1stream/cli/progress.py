"""Shows the progress and the events of a loop, from threads that the loop never waits for."""

from __future__ import annotations

import logging
import sys
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from g1stream.events import handled_by
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion

__all__ = ["Watch", "showing_progress"]

_PERIOD_S = 0.2
_PATIENCE_S = 1.0
_BAR = 30


class Watch:
    """Shows a progress bar on standard error, if that is a terminal.

    Args:
        loop: what is watched, until it is done.
        motion: what it plays.
    """

    def __init__(self, loop: StreamLoop, motion: Motion) -> None:
        self._loop = loop
        self._motion = motion
        self._clear = "\r\x1b[K" if sys.stderr.isatty() else ""
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def finish(self) -> None:
        """Remove the bar; waits 1 s at most."""
        self._over.set()
        self._thread.join(_PATIENCE_S)

    def _run(self) -> None:
        while self._loop.state.phase is not Phase.DONE:
            if self._clear:
                _write(f"{self._clear}{_bar(self._loop, self._motion)}")
            if self._over.wait(_PERIOD_S):
                break
        _write(self._clear)


class _Console(logging.Handler):
    """Prints events on standard error, above the progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        prefix = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        clear = "\r\x1b[K" if sys.stderr.isatty() else ""
        _write(f"{clear}{prefix}{record.getMessage()}\n")


@contextmanager
def showing_progress() -> Iterator[Callable[[StreamLoop, Motion], None]]:
    """Print events, and yield what is to be called when a loop begins, to show its progress."""
    watches: list[Watch] = []
    try:
        with handled_by(_Console()):
            yield lambda loop, motion: watches.append(Watch(loop, motion))
    finally:
        for watch in watches:
            watch.finish()


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
