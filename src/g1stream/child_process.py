"""Run one of the programs as a child process of another, connected by a pipe.

The parent sends a startup message and the child answers that it is ready. Later the parent sends a
final message, and the child finishes and answers with its result. A child also finishes when its
parent has ended for any reason.

Only the pipe of `multiprocessing` is used. Its processes import the user's script again, which must
be written for that, and receive Ctrl-C in the terminal.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, nullcontext, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import G1StreamError
from g1stream.optional import require_installed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import AbstractContextManager

    from g1stream.config import Config

__all__ = [
    "Child",
    "ChildError",
    "Parent",
    "optional_child",
    "process_state",
    "publishing_for_ros2",
    "run_child",
    "start_connected",
]

#: Modules of the programs outside `g1stream.app`.
_ELSEWHERE: Final = {
    "guard": "g1stream.control.guard",
    "live": "g1stream.extras.live.live",
    "receiver": "g1stream.recorder.receiver",
    "ros2": "g1stream.extras.ros2.topics",
}

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: Time between two heartbeats of a child, and silence after which a stopped and a running child
#: have failed, s.
_BEAT_PERIOD: Final = 0.5
_STOPPED_SILENCE: Final = 1.0
_MAX_SILENCE: Final = 5.0
#: Interval at which a wait for a child checks whether it is abandoned, s.
_POLL_PERIOD: Final = 0.05


class ChildError(G1StreamError):
    """A child process that failed or did not answer in time."""


def process_state(pid: int) -> str:
    """The state of a process as in proc(5), such as T for stopped; "" if there is no such process.

    A process that a fault is killing counts as X, also while its core is dumped.
    """
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return ""
    if "\nCoreDumping:\t1" in status:
        return "X"
    return status.partition("\nState:\t")[2][:1]


def _never() -> bool:
    return False


def start_connected(
    *arguments: str, pass_fds: Sequence[int] = ()
) -> tuple[Connection, subprocess.Popen[bytes]]:
    """Start Python connected by a pipe.

    Args:
        arguments: of Python; the file descriptor of the child's end is added to them.
        pass_fds: other file descriptors that the child inherits.

    Returns:
        The parent's end of the pipe, and the process.

    Raises:
        OSError: the system cannot start a process.
    """
    ours, theirs = Pipe()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, *arguments, str(theirs.fileno())],
            pass_fds=[theirs.fileno(), *pass_fds],
            stdin=subprocess.DEVNULL,
            stdout=2,  # output of libraries must not get into the parent's --json
            # The matrices are small; a pool of BLAS threads would only slow down the start.
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
            # Ctrl-C in the terminal reaches only the parent, which ends the child.
            start_new_session=True,
        )
    return ours, process


class Child:
    """A program running as a child process.

    Args:
        name: name of the program's module, which ends in a call of `run_child`.
        startup_message: input of the program; anything that can be pickled.
        pass_fds: file descriptors that the program inherits.
        on_failure: called once, from another thread, with the cause, when the program fails, ends
            unexpectedly, or sends no heartbeat (`Parent.beat`).

    Raises:
        ChildError: the system cannot start a process.
    """

    def __init__(
        self,
        name: str,
        startup_message: Any,
        *,
        pass_fds: Sequence[int] = (),
        on_failure: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.name = name
        self._on_failure = on_failure
        try:
            module = _ELSEWHERE.get(name, f"g1stream.app.{name}")
            self._connection, self._process = start_connected("-m", module, pass_fds=pass_fds)
        except OSError as error:
            raise ChildError(
                f"g1stream {name} cannot be started: {error.strerror}.",
                "Check the limits on open files, processes and memory with `ulimit -a`.",
            ) from error
        self._ready, self._ended = threading.Event(), threading.Event()
        self._result: Any = None
        self._error: ChildError | None = None
        self._beating = self._failed = self._finishing = False
        self._listener = threading.Thread(target=self._listen, name=name, daemon=True)
        self._listener.start()
        self._send(startup_message)

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        return self._process.pid

    def wait_until_ready(
        self, timeout: float = 20.0, abandoned: Callable[[], bool] = _never
    ) -> None:
        """Wait until the program is ready, or until `abandoned` returns True.

        Raises:
            ChildError: the program failed, ended, or was not ready within `timeout` s.
        """
        self._wait(self._ready, "be ready", timeout, abandoned)

    def finish(
        self,
        final_message: Any = None,
        timeout: float = 30.0,
        abandoned: Callable[[], bool] = _never,
    ) -> Any:
        """Tell the program to finish, wait until its process has ended, and return its result.

        Raises:
            ChildError: the program failed or did not finish within `timeout` s, or `abandoned`
                returned True. The process has ended in any case.
        """
        self._finishing = True
        try:
            self._send(final_message)
            self._wait(self._ended, "finish", timeout, abandoned)
            if not self._ended.is_set():
                raise ChildError(
                    f"g1stream {self.name} was ended before it finished.",
                    "Wait until it finishes, and interrupt g1stream only once.",
                )
            self._process.wait(timeout)
        except subprocess.TimeoutExpired as error:
            raise self._too_slow("end", timeout) from error
        finally:
            self.kill()
        return self._result

    def kill(self, *, at_once: bool = False) -> None:
        """End the process if it still runs, with SIGTERM and, after 5 s, with SIGKILL.

        Args:
            at_once: use SIGKILL immediately.
        """
        self._finishing = True
        if at_once or process_state(self._process.pid) in ("T", "t"):
            self._process.kill()
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._listener.join()
        self._connection.close()

    def resume(self) -> None:
        """Let the process continue if it is stopped."""
        with suppress(ProcessLookupError):
            os.kill(self._process.pid, signal.SIGCONT)

    def _wait(
        self, event: threading.Event, step: str, timeout: float, abandoned: Callable[[], bool]
    ) -> None:
        end = time.monotonic() + timeout
        while not event.wait(_POLL_PERIOD):
            if abandoned():
                return
            if time.monotonic() >= end:
                raise self._too_slow(step, timeout)
        if self._error:
            raise self._error

    def _send(self, message: Any) -> None:
        with suppress(OSError):  # the process has ended, which the listener reports
            self._connection.send(message)

    def _listen(self) -> None:
        """Receive the program's messages until it has ended."""
        try:
            while not self._ended.is_set():
                self._hear(*self._connection.recv())
                since = time.monotonic()
                while self._beating and not self._connection.poll(_BEAT_PERIOD):
                    self._check_silence(time.monotonic() - since)
        except (EOFError, OSError):
            code = self._process.wait()
            how = f"with exit code {code}" if code >= 0 else f"by {signal.Signals(-code).name}"
            self._error = ChildError(
                f"g1stream {self.name} ended {how}.",
                "See its output above for the reason."
                if self.name in _ELSEWHERE
                else f"Run g1stream {self.name} by itself to see the reason.",
            )
        if self._error:
            self._fail(self._error.cause)
        self._ready.set()
        self._ended.set()

    def _hear(self, kind: str, value: Any) -> None:
        if kind == "ready":
            self._ready.set()
        elif kind == "alive":
            self._beating = True
        elif kind == "failed":
            self._fail(value)
            if not self._ready.is_set():
                self._error = ChildError(value, "Fix this and run it again.")
                self._ready.set()
        elif kind == "error":
            self._error = ChildError(*value)
            self._ended.set()
        else:
            self._fail(f"g1stream {self.name} ended unexpectedly.")
            self._result = value
            self._ended.set()

    def _check_silence(self, silence: float) -> None:
        if self._connection.poll():  # this process was delayed and has not read the message yet
            return
        stopped = process_state(self._process.pid) in ("T", "t")
        if silence >= (_STOPPED_SILENCE if stopped else _MAX_SILENCE):
            how = "is stopped" if stopped else f"has not responded for {silence:.0f} s"
            self._fail(f"g1stream {self.name} {how}.")

    def _fail(self, cause: str) -> None:
        if not (self._failed or self._finishing):
            self._failed = True
            self._on_failure(cause)

    def _too_slow(self, step: str, timeout: float) -> ChildError:
        return ChildError(
            f"g1stream {self.name} did not {step} within {timeout:g} s.",
            "Check with `top` which other programs use the CPUs.",
        )


@contextmanager
def optional_child(
    name: str, startup_message: Any, consequence: str, abandoned: Callable[[], bool] = _never
) -> Iterator[None]:
    """Context manager that runs a program whose failure does not stop the others.

    Args:
        name: as of `Child`.
        startup_message: as of `Child`.
        consequence: effect of a later failure, for the warning; the failure has no other effect.
        abandoned: called while the program starts; True ends the wait for it.

    Raises:
        ChildError: the program cannot be started, or failed before it was ready.
    """
    ready = False

    def warn(cause: str) -> None:
        if ready:  # before that, the failure is raised
            logging.getLogger(f"g1stream.{name}").warning("%s: %s", consequence, cause)

    child = Child(name, startup_message, on_failure=warn)
    try:
        child.wait_until_ready(abandoned=abandoned)
        ready = True
        yield
    finally:
        child.kill()


def publishing_for_ros2(
    config: Config, abandoned: Callable[[], bool] = _never
) -> AbstractContextManager[None]:
    """Publish for ROS 2 from a separate process if `dds.ros_tf` is set; needs the extra `ros2`.

    Args:
        config: all settings.
        abandoned: as of `optional_child`.

    Raises:
        ConfigError: the extra `ros2` is not installed.
        ChildError: on entering the context, the process failed before it was ready.
    """
    if not config.dds.ros_tf:
        return nullcontext()
    require_installed("rosbags", "ros2", "Topics of ROS 2 need")
    consequence = "publishing for ROS 2 has stopped"
    return optional_child("ros2", config, consequence, abandoned)


class Parent:
    """The child's side of the pipe.

    Attributes:
        startup_message: input of the program.
        final_message: message of the request to finish; None if the parent has ended without one.
        done: set when the program must finish, on the parent's request, its end, or a signal.
        signal: name of the received signal, or "".
        gone: when the parent ended without a request to finish, s of CLOCK_MONOTONIC.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self.startup_message = connection.recv()
        self.final_message: Any = None
        self.signal = ""
        self.gone: float | None = None
        self.done = threading.Event()
        self._next_beat = 0.0
        threading.Thread(target=self._wait, name="parent", daemon=True).start()

    def ready(self) -> None:
        """Report that the program is ready."""
        self._send("ready", None)

    def beat(self) -> None:
        """Send a heartbeat, at most every 0.5 s; after the first one, the parent expects them."""
        if time.monotonic() >= self._next_beat:
            self._next_beat = time.monotonic() + _BEAT_PERIOD
            self._send("alive", None)

    def failed(self, cause: str) -> None:
        """Report that the program cannot do its task; it continues until it is told to finish."""
        self._send("failed", cause)

    def end_by_signal(self, number: int, _: object) -> None:
        """Handle a signal."""
        self.signal = signal.Signals(number).name
        self.done.set()

    def _wait(self) -> None:
        try:
            self.final_message = self._connection.recv()
        except (EOFError, OSError):
            self.gone = time.monotonic()
        self.done.set()

    def _send(self, kind: str, value: Any) -> None:
        with suppress(OSError):  # the parent is gone
            self._connection.send((kind, value))


def run_child(program: Callable[[Parent], Any]) -> None:
    """Run a program in this process for the parent that started it, and exit.

    Args:
        program: returns its picklable result soon after `Parent.done` is set.
    """
    parent = Parent(Connection(int(sys.argv[1])))
    for number in _SIGNALS:
        signal.signal(number, parent.end_by_signal)
    try:
        result = program(parent)
    except G1StreamError as error:
        parent._send("error", (error.cause, error.remedy))
        sys.exit(2)
    parent._send("done", result)
