"""A program of ours run as a child process of another, connected by a pipe.

The parent sends a startup message, the child answers that it is ready; later the parent sends a
final message, the child finishes and answers with its result. A child whose parent is gone, however
that ended, finishes as well.

`multiprocessing` would start the child by importing the user's script once more, which has to be
written for that, and leaves Ctrl-C in the terminal to the child, too; so only its pipe is used.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import G1StreamError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Child", "ChildError", "Parent", "run_child"]

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class ChildError(G1StreamError):
    """A child process failed, or did not answer in time."""


class Child:
    """A program running as a child process.

    Args:
        name: of the module in `g1stream.programs` that ends in a call of `run_child`.
        startup_message: what the program is to do; anything that can be pickled.
    """

    def __init__(self, name: str, startup_message: Any) -> None:
        self.name = name
        self._connection, theirs = Pipe()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", f"g1stream.programs.{name}", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what a library prints must not get into our --json
                # Our matrices are small; a pool of BLAS threads would only cost time at the start.
                env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
                # Ctrl-C in the terminal goes to the parent only, which ends the child.
                start_new_session=True,
            )
        self._send(startup_message)

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def wait_until_ready(self, timeout: float = 20.0) -> None:
        """Wait until the program says that it is ready.

        Raises:
            ChildError: it failed, ended or was not ready in time, s.
        """
        self._receive("ready", timeout)

    def finish(self, final_message: Any = None, timeout: float = 30.0) -> Any:
        """Tell the program to finish, wait until its process has ended, and return its result.

        Raises:
            ChildError: it failed or did not finish in time, s; the process is gone all the same.
        """
        try:
            self._send(final_message)
            result = self._receive("done", timeout)
            self._process.wait(timeout)
        except subprocess.TimeoutExpired as error:
            raise self._too_slow("end", timeout) from error
        finally:
            self.kill()
        return result

    def kill(self) -> None:
        """End the process if it still runs: by SIGTERM and, where that does not help, SIGKILL."""
        self._connection.close()
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _send(self, message: Any) -> None:
        with suppress(OSError):  # the process has ended; `_receive` says so
            self._connection.send(message)

    def _receive(self, expected: str, timeout: float) -> Any:
        if not self._connection.poll(timeout):
            raise self._too_slow(f"say {expected!r}", timeout)
        try:
            kind, value = self._connection.recv()
        except (EOFError, OSError):
            code = self._process.wait()
            how = f"with exit code {code}" if code >= 0 else f"by {signal.Signals(-code).name}"
            raise ChildError(
                f"g1stream {self.name} ended {how}.",
                f"Run g1stream {self.name} by itself to see why.",
            ) from None
        if kind == "error":
            raise ChildError(*value)
        return value

    def _too_slow(self, step: str, timeout: float) -> ChildError:
        return ChildError(
            f"g1stream {self.name} did not {step} within {timeout:g} s.",
            f"Run g1stream {self.name} by itself to see what delays it.",
        )


class Parent:
    """The child's side of the pipe.

    Attributes:
        startup_message: what the program is to do.
        final_message: what came with the request to finish; None where the parent is gone.
        done: set when the program is to finish: the parent said so, or is gone, or a signal came.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self.startup_message = connection.recv()
        self.final_message: Any = None
        self.done = threading.Event()
        threading.Thread(target=self._wait, name="parent", daemon=True).start()

    def ready(self) -> None:
        self._send("ready", None)

    def _wait(self) -> None:
        with suppress(EOFError, OSError):
            self.final_message = self._connection.recv()
        self.done.set()

    def _send(self, kind: str, value: Any) -> None:
        with suppress(OSError):  # the parent is gone
            self._connection.send((kind, value))


def run_child(program: Callable[[Parent], Any]) -> None:
    """Run a program in this process for the parent that started it, and exit.

    Args:
        program: returns its result, which must be picklable, soon after `Parent.done` is set.
    """
    parent = Parent(Connection(int(sys.argv[1])))
    for number in _SIGNALS:
        signal.signal(number, lambda *_: parent.done.set())
    try:
        result = program(parent)
    except G1StreamError as error:
        parent._send("error", (error.cause, error.remedy))
        sys.exit(2)
    parent._send("done", result)
