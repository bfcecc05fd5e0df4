"""Programs in processes forked from one that has imported what they need.

Each row starts several programs, and their imports would take longer than they do. They are forked
by the fork server of `multiprocessing`, because pytest itself has threads and joins DDS domains.
The end of an interpreter is no part of such a program: it runs no `atexit` handlers.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import forkserver, reduction
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_CONTEXT: Final = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(
    ["g1stream.app.stream", "g1stream.cli.stream", "g1stream.control.loop", "mujoco", "fastcrc"]
)
#: Of two threads that ask for the end of a process, one would be told a wrong exit code.
_LOCK: Final = threading.Lock()


def start_server() -> None:
    """Start the fork server; call it in the main thread, see `engine.ENVIRONMENT`."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # it must have no other thread
    forkserver.ensure_running()


class Forked:
    """A running program, used like a `subprocess.Popen`.

    Args:
        module: whose `main()` is the program.
        arguments: of the program.
        environment: of the program. Variables that are read as an interpreter starts, or in an
            import, have no effect.
        streams: descriptors of its standard input, output and error.
    """

    def __init__(
        self,
        module: str,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        streams: Sequence[int],
    ) -> None:
        given = module, list(arguments), dict(environment), [_Sent(one) for one in streams]
        self._process = _CONTEXT.Process(target=_run, args=given)
        with _LOCK:
            self._process.start()
        assert self._process.pid
        self.pid = self._process.pid

    def poll(self) -> int | None:
        with _LOCK:
            return self._process.exitcode

    def wait(self, timeout: float = float("inf")) -> int:
        end = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > end:
                raise subprocess.TimeoutExpired(self._process.name, timeout)
            time.sleep(0.01)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class _Sent:
    """A file descriptor that the other process gets a duplicate of."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def __reduce__(self) -> Any:
        return _received, (reduction.DupFd(self._descriptor),)


def _received(duplicate: Any) -> int:
    descriptor: int = duplicate.detach()
    return descriptor


def _run(
    module: str, arguments: list[str], environment: dict[str, str], streams: list[int]
) -> None:
    for number, descriptor in enumerate(streams):
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [module, *arguments]
    sys.exit(importlib.import_module(module).main())
