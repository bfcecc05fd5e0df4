"""Shows how a loop goes, from a thread beside it that the loop never waits for."""

from __future__ import annotations

import sys
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion

__all__ = ["Watch", "watching"]

_PERIOD_S = 0.2
_PATIENCE_S = 1.0
_BAR = 30


class Watch:
    """Prints events as lines and, on a terminal, a progress bar; on standard error.

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
        """Print what is left, so that the next thing printed comes after it; waits 1 s at most."""
        self._over.set()
        self._thread.join(_PATIENCE_S)
        if not self._thread.is_alive():
            self._print_events()  # those told since the thread last looked

    def _run(self) -> None:
        while True:
            done = self._loop.state.phase is Phase.DONE
            self._print_events()
            if done:
                return
            if self._clear:
                _write(f"{self._clear}{_bar(self._loop, self._motion)}")
            if self._over.wait(_PERIOD_S):
                _write(self._clear)
                return

    def _print_events(self) -> None:
        while self._loop.events:
            _, text = self._loop.events.popleft()
            _write(f"{self._clear}{text}\n")


@contextmanager
def watching() -> Iterator[Callable[[StreamLoop, Motion], None]]:
    """Give what is called when a loop begins; at the end of the `with`, all it told is printed."""
    watches: list[Watch] = []
    try:
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
