"""Function calls in child processes, with limits of time and memory.

A motion file that crashes its reader does not stop the program. Each thread that calls `limited`
has one process, which is kept for the next call and replaced when it has ended.

Pools of processes share locks between them, and wait for a lock that a killed process held. Here
each process has a pipe of its own, which the system closes. `multiprocessing.Process` would refuse
to start below a worker of Dask with a nanny.
"""

from __future__ import annotations

import os
import pickle
import resource
import sys
import threading
import traceback
from concurrent.futures import CancelledError
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

from g1stream.child_process import start_connected
from g1stream.errors import G1StreamError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["CrashedError", "Limits", "TooSlowError", "end_processes", "limited"]

T = TypeVar("T")

#: Longest timeout for poll(2), which takes 24 days at most, s.
_LONGEST_POLL: Final = 1e6


class TooSlowError(G1StreamError):
    """A call took longer than its limit."""


class CrashedError(G1StreamError):
    """The process of a call ended twice."""


@dataclass(frozen=True)
class Limits:
    """Limits of a call.

    Attributes:
        seconds: time limit.
        megabytes: memory limit, 10^6 bytes, in addition to about 200 that the process has at
            first. Beyond it the call gets a `MemoryError`.
    """

    seconds: float = 600.0
    megabytes: float = 4000.0

    def __str__(self) -> str:
        return f"{self.seconds:g} s, {self.megabytes:g} MB"


def limited(limits: Limits, function: Callable[..., T], *args: Any) -> T:
    """Call a function in the process of this thread.

    If the process ends, because of the call or because it was killed, the call is repeated once.

    Args:
        limits: limits of time and memory.
        function: function of a module. It, its arguments, its result and its exception are pickled.
        args: arguments of the function.

    Raises:
        TooSlowError: it exceeded the time limit.
        CrashedError: its process ended twice.
        CancelledError: `end_processes` was called meanwhile.
        OSError: the system cannot start a process, or it ended twice before it was ready.
        Exception: what the function raised.
    """
    for _ in range(2):
        process = _process_of_thread(limits)
        try:
            process.wait_until_ready()
            process.connection.send((function, args))
            in_time = process.connection.poll(min(limits.seconds, _LONGEST_POLL))
            result, error = process.connection.recv() if in_time else (None, None)
        except (EOFError, OSError):  # the process has ended
            if process not in _RUNNING:
                raise CancelledError from None
            process.end()
            continue
        except BaseException:  # the next call would take the answer to this one
            process.end()
            raise
        if not in_time:
            process.end()
            raise TooSlowError(f"It took longer than {limits.seconds:g} s.", "Raise --time-limit.")
        if error is not None:
            raise error
        return cast("T", result)
    if not process.ready:
        raise OSError("A process for the computation ended twice while it started.")
    raise CrashedError(
        "The process that computed it crashed, twice.",
        "Read the file with `g1stream motion`, and report the result.",
    )


class _Process:
    """A process that makes the calls of one thread."""

    def __init__(self, limits: Limits) -> None:
        self.limits, self.ready = limits, False
        # The path of this process, as -m would add the working directory.
        program = f"import sys; sys.path[:] = {sys.path}; from {__name__} import make_calls; "
        program += f"make_calls(int(sys.argv[1]), {limits.megabytes})"
        self.connection, self._process = start_connected("-c", program)

    def wait_until_ready(self) -> None:
        if not self.ready:
            self.connection.recv()
            self.ready = True

    def end(self) -> None:
        """Kill the process. The connection stays open, because its thread may wait for it."""
        _RUNNING.discard(self)
        self._process.kill()
        self._process.wait()


_THREAD = threading.local()
_RUNNING: Final[set[_Process]] = set()


def _process_of_thread(limits: Limits) -> _Process:
    """The thread's process; a new one for other limits."""
    process: _Process | None = getattr(_THREAD, "process", None)
    if process in _RUNNING and process.limits == limits:
        return process
    if process:
        process.end()
    _THREAD.process = process = _Process(limits)
    _RUNNING.add(process)
    return process


def end_processes() -> None:
    """End the processes of all threads; their computations are lost.

    A process that another thread is just starting is not ended.
    """
    for process in list(_RUNNING):
        process.end()


def make_calls(pipe: int, megabytes: float) -> None:
    """Make the calls of the parent, in the child process, until the parent ends.

    Args:
        pipe: file descriptor of the child's end.
        megabytes: as of `Limits`.
    """
    os.set_inheritable(pipe, False)  # the parent must notice the end of this process alone
    parent = Connection(pipe)
    calls: SimpleQueue[tuple[Callable[..., Any], tuple[Any, ...]]] = SimpleQueue()
    threading.Thread(target=_receive, args=(parent, calls), daemon=True).start()
    for module in ("g1stream.extras.library.compute", "mujoco", "scipy.interpolate"):
        import_module(module)  # not within the time and memory limits of the first call
    # In the unit of RLIMIT_DATA (proc(5), statm): private writable memory.
    own = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
    most = own + round(megabytes * 1e6)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    parent.send("ready")
    while True:
        function, args = calls.get()
        try:
            answer = pickle.dumps((function(*args), None))
        except Exception as error:  # also one of pickling, for which the memory may not suffice
            answer = pickle.dumps((None, error.with_traceback(None)))
        parent.send_bytes(answer)


def _receive(parent: Connection, calls: SimpleQueue[Any]) -> None:
    """Receive the calls in a thread, which notices the parent's end during a call."""
    try:
        while True:
            calls.put(parent.recv())
    except (EOFError, OSError):
        pass
    except BaseException:
        traceback.print_exc()
    os._exit(1)
