"""Function calls in child processes, with limits of time and memory.

A motion file that crashes its reader does not stop the program. Each thread that calls `limited`
has one process, which is kept for the next call and replaced when it has ended.
"""

from __future__ import annotations

import os
import resource
import signal
import threading
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import connection, get_context, parent_process
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from g1stream.errors import G1StreamError
from g1stream.optional import import_extra

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["CrashedError", "Limits", "TooSlowError", "end_processes", "limited"]

T = TypeVar("T")


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
        function: function of a module. It, its arguments and its result are pickled.
        args: arguments of the function.

    Raises:
        TooSlowError: it exceeded the time limit.
        CrashedError: its process ended twice.
        CancelledError: `end_processes` was called meanwhile.
        ConfigError: the extra `library` is not installed.
    """
    pebble = import_extra("pebble", "library", "A library needs")
    for _ in range(2):
        pool, future = _pool_of_thread(limits), None
        try:
            future = pool.schedule(function, args=args, timeout=limits.seconds)
            _RUNNING.add(future)
            result: T = future.result()
        except FutureTimeoutError:
            raise TooSlowError(
                f"It took longer than {limits.seconds:g} s.", "Raise --time-limit."
            ) from None
        except pebble.ProcessExpired:
            continue
        except RuntimeError:
            if pool.active or pool not in _POOLS:
                raise
            _end(pool)  # a process killed during its start breaks a pool permanently
            continue
        finally:
            _RUNNING.discard(future)
        return result
    raise CrashedError(
        "The process that computed it crashed, twice.",
        "Read the file with `g1stream motion`, and report the result.",
    )


_THREAD = threading.local()
_POOLS: Final[set[Any]] = set()
_RUNNING: Final[set[Any]] = set()


def _pool_of_thread(limits: Limits) -> Any:
    """The thread's pool of one process; a new one for other limits."""
    from pebble import ProcessPool

    pool, made_for = getattr(_THREAD, "pool", (None, None))
    if pool is None or pool not in _POOLS or made_for != limits:
        if pool in _POOLS:
            _end(pool)
        # The matrices are small; a pool of BLAS threads would take time from other processes.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        megabytes = (limits.megabytes,)
        pool = ProcessPool(1, initializer=_begin, initargs=megabytes, context=get_context("spawn"))
        _POOLS.add(pool)
        _THREAD.pool = pool, limits
    return pool


def _end(pool: Any) -> None:
    _POOLS.discard(pool)
    pool.stop()
    pool.join()


def end_processes() -> None:
    """End the processes of all threads; their computations are lost."""
    for future in list(_RUNNING):
        future.cancel()
    for pool in list(_POOLS):
        _end(pool)


def _begin(megabytes: float) -> None:
    """Initialise a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the parent
    os.dup2(2, 1)  # output of other libraries must not mix with --json
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for module in ("g1stream.extras.library.compute", "mujoco", "scipy.interpolate"):
        import_module(module)  # not within the time and memory limits of the first call
    # In the unit of RLIMIT_DATA (proc(5), statm): private writable memory.
    own = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
    most = own + round(megabytes * 1e6)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent
    connection.wait([parent.sentinel])
    os._exit(1)
