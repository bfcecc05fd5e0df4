"""The progress of a run, on standard error."""

from __future__ import annotations

import sys
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion

__all__ = ["ProgressDisplay", "loop_progress"]

_PERIOD_S: Final = 0.5
_JOIN_TIMEOUT_S: Final = 1.0


class ProgressDisplay:
    """A progress bar on standard error if that is a terminal, for the length of a `with`.

    What is printed on standard error meanwhile appears above the bar. A thread draws it, so that a
    slow or closed terminal does not hold up what it shows.

    Args:
        progress: returns what fraction is done, 0 to 1, and a text; called a few times a second.
    """

    def __init__(self, progress: Callable[[], tuple[float, str]]) -> None:
        self._progress = progress
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name="progress", daemon=True)

    def __enter__(self) -> ProgressDisplay:
        if sys.stderr.isatty():
            import rich.progress  # noqa: F401  # now, and not when the loop already runs

            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        if self._thread.ident is not None:
            self._thread.join(_JOIN_TIMEOUT_S)

    def _run(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        bar = Progress(
            BarColumn(30),
            TextColumn("{task.description}", markup=False),
            console=Console(stderr=True, highlight=False),
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,  # which may be a file with JSON
        )
        task, done = bar.add_task("", total=1.0), False
        with suppress(OSError), bar:
            while not done:
                done = self._done.wait(_PERIOD_S)
                fraction, text = self._progress()
                bar.update(task, completed=fraction, description=text, refresh=True)


def loop_progress(loop: StreamLoop, motion: Motion) -> tuple[float, str]:
    """How much of a motion a loop has played, with phase, time and worst lateness."""
    fraction = min(1.0, loop.motion_time / motion.duration) if motion.duration else 1.0
    lateness = loop.report.lateness.maximum_ns / 1e6
    return fraction, (
        f"{loop.state.phase.name:<5}{loop.motion_time:6.1f} / {motion.duration:.1f} s, "
        f"worst lateness {lateness:.2f} ms"
    )
