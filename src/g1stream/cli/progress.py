"""The live status of a run on standard error, if that is a terminal."""

from __future__ import annotations

import os
import sys
import threading
import time
from contextlib import contextmanager, suppress
from math import inf
from typing import TYPE_CHECKING, Any, Final, TextIO, cast

from g1stream.events import is_quiet
from g1stream.robot.joints import JOINT_GROUPS
from g1stream.text import counted
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rich.console import Console

    from g1stream.control.command import Prepared
    from g1stream.control.loop import StreamLoop
    from g1stream.motion.motion import Motion
    from g1stream.recorder.recorder import Recorder
    from g1stream.sim.robot import SimReport

_PERIOD_S: Final = 0.1
#: Time between progress lines if standard error is no terminal, s.
_IN_PIPE_S: Final = 5.0
_JOIN_TIMEOUT_S: Final = 1.0
_BAR: Final = 20
#: Erases from the cursor to the end of the screen.
_ERASE: Final = "\x1b[J"


class _AboveStatus:
    """Standard error with a status on it. The first write erases the status."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        return self._stream.write(f"{_ERASE}{text}")


class ProgressDisplay:
    """Shows a status of a few lines on standard error, if that is a terminal, in a `with`.

    A thread draws it, so that a slow or closed terminal does not delay the work. Between two
    drawings the cursor is on an empty line above the status. Text that this process or a child
    process prints on standard error appears there and stays.

    Args:
        status: returns the fraction that is done, 0 to 1 or None, and lines of text. It is called
            ten times a second.
        in_pipe: time between lines with the status if standard error is no terminal, s; None for
            no lines.
    """

    def __init__(
        self, status: Callable[[], tuple[float | None, str]], in_pipe: float | None = None
    ) -> None:
        self._status, self._in_pipe = status, None if is_quiet() else in_pipe
        self._stream = sys.stderr
        silent = is_quiet() or os.environ.get("TERM") in ("dumb", "unknown")
        self._on_terminal = self._stream.isatty() and not silent
        self._done = threading.Event()
        run = self._draw if self._on_terminal else self._print
        self._thread = threading.Thread(target=run, name="progress", daemon=True)

    def __enter__(self) -> ProgressDisplay:
        if self._on_terminal:
            import rich.console
            import rich.progress_bar
            import rich.table  # noqa: F401  # now, and not when the loop already runs

            sys.stderr = cast("TextIO", _AboveStatus(self._stream))
        if self._on_terminal or self._in_pipe:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        if self._thread.ident is not None:
            self._thread.join(_JOIN_TIMEOUT_S)
            sys.stderr = self._stream

    def _print(self) -> None:
        with suppress(OSError):
            while not self._done.wait(self._in_pipe):
                print(self._status()[1], file=self._stream, flush=True)

    def _draw(self) -> None:
        from rich.console import Console

        console = Console(file=self._stream, highlight=False)
        with suppress(OSError):
            while not self._done.wait(_PERIOD_S):
                self._stream.write(_frame(console, *self._status()))
                self._stream.flush()
            self._stream.write(_ERASE)
            self._stream.flush()


@contextmanager
def showing_progress() -> Iterator[Callable[[str, float], None]]:
    """Show a status while something is read; the callback takes a label and the fraction done.

    If standard error is no terminal, it prints a line every few seconds.
    """
    done: tuple[float | None, str] = None, "reading"

    def progress(what: str, fraction: float) -> None:
        nonlocal done
        done = fraction, f"{what} {100 * fraction:3.0f} %"

    with ProgressDisplay(lambda: done, in_pipe=_IN_PIPE_S):
        yield progress


def _frame(console: Console, fraction: float | None, text: str) -> str:
    """Control sequences that draw a status below the cursor's line, and restore the cursor."""
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    first, *others = (Text(line, no_wrap=True, overflow="ellipsis") for line in text.split("\n"))
    with console.capture() as drawn:
        if fraction is None:
            console.print(first)
        else:
            row = Table.grid(padding=(0, 2))
            row.add_row(ProgressBar(total=1.0, completed=fraction, width=_BAR), first)
            console.print(row)
        for line in others:
            console.print(line)
    lines = drawn.get()
    return f"{_ERASE}\n{lines}\x1b[{lines.count(chr(10)) + 1}F"


def loop_status(loop: StreamLoop, motion: Motion) -> tuple[float, str]:
    """Phase, time, rate, lateness, age of the state, and the tracking error by limb."""
    report, phase, newest = loop.report, loop.state.phase, loop.newest
    start, end = loop.part
    length = motion.duration if end == inf else end - start
    passed = max(0.0, loop.motion_time - start)
    fraction = min(1.0, passed / length) if length else 1.0
    rate = f"  {report.rate:.2f} Hz" if report.rate else ""
    text = f"{phase.name:<4}  {passed:.2f} of {length:.2f} s{rate}"
    if newest is None:
        return fraction, text
    late = report.lateness
    text += (
        f"\nlate {late.newest_ns / 1e6:.2f} ms, worst {late.maximum_ns / 1e6:.2f} ms, "
        f"{counted(report.skipped, 'tick')} skipped"
    )
    if newest.measured:
        text += f"; state {(time.monotonic_ns() - newest.measured.arrived) / 1e6:.0f} ms old"
    return fraction, f"{text}\n{_errors(phase, newest)}"


def _errors(phase: Phase, newest: Prepared) -> str:
    """RMS of target - measured, by limb. There is no target in DAMP."""
    if newest.measured is None or phase is Phase.DAMP:
        return ""
    # The target at the time of the measurement, because the next command's time is later.
    ahead = (newest.due - newest.measured.arrived) / 1e9
    error = newest.target.q - ahead * newest.target.dq - newest.measured.q
    rms = {
        name.replace("left_", "L ").replace("right_", "R "): (error[list(joints)] ** 2).mean()
        ** 0.5
        for name, joints in JOINT_GROUPS.items()
    }
    return f"error {'  '.join(f'{name} {value:.4f}' for name, value in rms.items())} rad"


class RecorderStatus:
    """How long a recorder has recorded, and the rate of each DDS topic in the last second."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._counts, self._counted_at = recorder.received, time.monotonic()
        self._rates = ""

    def __call__(self) -> tuple[None, str]:
        """The status in the form that `ProgressDisplay` shows."""
        report, seconds = self._recorder.report, time.monotonic() - self._counted_at
        if seconds >= 1.0:
            counts, before = self._recorder.received, self._counts
            self._counts, self._counted_at = counts, time.monotonic()
            self._rates = "  ".join(
                f"{topic.removeprefix('/')} {(n - before.get(topic, 0)) / seconds:.0f}"
                for topic, n in counts.items()
            )
        if report.first_ns is None:
            return None, "nothing received yet"
        recorded = ((report.last_ns or report.first_ns) - report.first_ns) / 1e9
        return None, f"recorded {recorded:.1f} s; samples per second:\n{self._rates}"


def sim_status(report: SimReport) -> tuple[None, str]:
    """Simulated time, and counts of published states and accepted and refused commands."""
    refused = sum(list(report.refused.values()))  # a copy, because it may grow meanwhile
    return None, (
        f"simulated {report.simulated:.1f} s, {report.behind:.2f} s skipped; "
        f"{counted(report.states, 'state')}, {counted(report.commands, 'command')}, "
        f"{refused} refused"
    )
