"""Calls in processes of their own, with limits of time and memory.

Whatever a motion file makes of its reader, the program that asked goes on: each thread that calls
`limited` has one process, which is kept for the next call and replaced when it ended.
"""

from __future__ import annotations

import faulthandler
import os
import resource
import signal
import threading
import time
from concurrent.futures import CancelledError, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import connection, get_context, parent_process
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from g1stream.errors import G1StreamError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["CrashedError", "Limits", "TooSlowError", "end_processes", "limited"]

T = TypeVar("T")


class TooSlowError(G1StreamError):
    """A call took longer than its limit."""


class CrashedError(G1StreamError):
    """The process of a call ended, twice."""


@dataclass(frozen=True)
class Limits:
    """What a call may take.

    Attributes:
        seconds: of time.
        megabytes: of memory, 10^6 bytes, beyond what the process has at first, some 200; with more
            the call gets a `MemoryError`.
    """

    seconds: float = 600.0
    megabytes: float = 4000.0

    def __str__(self) -> str:
        return f"{self.seconds:g} s, {self.megabytes:g} MB"


class _Process:
    """A process that makes one call after the other.

    Attributes:
        limits: of each call.
        ended: whether `close` was called.
        begun: when the last call began, `time.monotonic()`.
    """

    def __init__(self, limits: Limits) -> None:
        # Our matrices are small; a pool of BLAS threads would take the time of other processes.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        self.limits = limits
        self.ended = False
        self.begun = time.monotonic()
        self._pool = ProcessPoolExecutor(1, get_context("spawn"), _begin, (limits,))
        self._pid: int | None = None
        _PROCESSES.add(self)

    def call(self, function: Callable[..., T], *args: Any) -> T:
        if self._pid is None:  # which starts it
            self._pid = self._pool.submit(os.getpid).result()
        if self.ended:
            self.close()
            raise CancelledError
        self.begun = time.monotonic()
        return self._pool.submit(_timed, self.limits.seconds, function, args).result()

    def close(self) -> None:
        """Kill it; what it computes is lost."""
        self.ended = True
        _PROCESSES.discard(self)
        if self._pid is not None:
            with suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
        self._pool.shutdown(wait=False)


_PROCESSES: Final[set[_Process]] = set()
_THREAD: Final = threading.local()


def limited(limits: Limits, function: Callable[..., T], *args: Any) -> T:
    """Call a function in the process of this thread.

    A process that ends before its time, because of the call or because somebody killed it, is
    replaced and the call made once more.

    Args:
        limits: of time and memory.
        function: of a module; it, its arguments and what it returns are pickled.
        args: of the function.

    Raises:
        TooSlowError: it took longer than it may.
        CrashedError: its process ended, twice.
        CancelledError: `end_processes` was called meanwhile.
    """
    for _ in range(2):
        process: _Process | None = getattr(_THREAD, "process", None)
        if process is None or process.ended or process.limits != limits:
            if process:
                process.close()
            process = _THREAD.process = _Process(limits)
        try:
            return process.call(function, *args)
        except BrokenProcessPool:
            if process.ended:
                raise CancelledError from None
            process.close()
            if time.monotonic() - process.begun >= limits.seconds:
                raise TooSlowError(
                    f"It took longer than {limits.seconds:g} s.", "Raise --time-limit."
                ) from None
    raise CrashedError(
        "The process that computed it crashed, twice.",
        "Read the file with `g1stream motion`, and report what happens.",
    )


def end_processes() -> None:
    """End the processes of all threads; what they compute is lost."""
    for process in list(_PROCESSES):
        process.close()


def _begin(limits: Limits) -> None:
    """What a process does first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the parent
    os.dup2(2, 1)  # what a library prints must not get into our --json
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for module in ("g1stream.extras.library.compute", "mujoco", "scipy.interpolate"):
        import_module(module)  # now, and not in the time and memory of the first call
    # As RLIMIT_DATA counts it (proc(5), statm): private memory that can be written.
    own = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
    most = own + round(limits.megabytes * 1e6)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent
    connection.wait([parent.sentinel])
    os._exit(1)


def _timed(seconds: float, function: Callable[..., T], args: tuple[Any, ...]) -> T:
    """Call it; a thread of C ends the process after so many s, whatever holds the interpreter."""
    with Path(os.devnull).open("w") as nothing:
        faulthandler.dump_traceback_later(seconds, exit=True, file=nothing)
        try:
            return function(*args)
        finally:
            faulthandler.cancel_dump_traceback_later()
