"""The guard of a stream: a process that damps the robot if the stream cannot.

It joins the DDS domain before the first command and watches the stream's heartbeat. It publishes
LowCmd only after the stream was killed or stopped, hangs, or gets no CPU time. It has its own
process session and ignores signals, so that the event that ends the stream does not end the guard.

The stream writes its heartbeat and a copy of each command into shared memory. No command of the
stream follows the guard's first one: the guard shares the stream's DDS sockets, and shuts them down
for sending before it damps. The stream also checks before each write whether the guard has taken
over. docs/safety.md explains the guard.
"""

from __future__ import annotations

import logging
import mmap
import os
import signal
import socket
import sys
import time
from contextlib import contextmanager, suppress
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from cyclonedds.core import DDSException

from g1stream.child_process import Child, ChildError, process_state, run_child
from g1stream.clock import SystemClock, Ticker
from g1stream.control.receiver import Receiver, load_receiver
from g1stream.control.stop import Stop
from g1stream.dds.discovery import IDLE, PUBLISHING
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.layout import Layout
from g1stream.dds.log_handler import dds_log_handler
from g1stream.dds.messages import LowCmd
from g1stream.errors import ConfigError, SafetyError
from g1stream.events import GUARD, ConsoleHandler, handled_by
from g1stream.network import is_local_only
from g1stream.realtime import allow_all_cpus, on_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from g1stream.child_process import Parent
    from g1stream.config import Config
    from g1stream.types import Via

__all__ = [
    "Guard",
    "Heartbeat",
    "Takeover",
    "Watch",
]

_LOGGER = logging.getLogger("g1stream.guard")  # in the child process, this module is __main__

#: Silence after which the guard checks whether the stream is stopped or has ended, ns.
_STATE_CHECK: Final = 20_000_000
#: Time between two of these checks, ns.
_CHECK_PERIOD: Final = 10_000_000

_COMMAND_SIZE: Final = Layout.of(LowCmd.idl_type).sample_size
#: The fields of the shared memory, each an int64. They are followed by the stream's last command.
_LAST_WRITE, _WRITING, _TAKEOVER, _SUBSCRIBERS, _FIELDS = range(5)
#: Silence after which a running stream is replaced if there may be a robot, s.
_ROBOT_SILENCE: Final = 0.04
#: Interval at which subscribers are counted before the first command, ns.
_DISCOVERY_PERIOD: Final = 20_000_000
#: Interval at which the guard checks whether a write has ended, s.
_WRITE_POLL: Final = 0.0002
#: Maximum wait of the guard for the end of a write, s. A write takes about 20 us of CPU time.
_WRITE_TIMEOUT: Final = 0.002
#: Maximum time that the process takes to end, s, in addition to the time of damping.
_END_TIMEOUT: Final = 2.0


class Takeover(IntEnum):
    """Why the guard commands the robot instead of the stream."""

    NONE = 0
    ENDED = 1
    STOPPED = 2
    SILENT = 3

    def __str__(self) -> str:
        return {
            Takeover.NONE: "",
            Takeover.ENDED: "was killed or crashed",
            Takeover.STOPPED: "was stopped",
            Takeover.SILENT: "did not send a command in time",
        }[self]


class Heartbeat:
    """Memory that a stream and its guard share.

    Args:
        memory: file descriptor of another process's heartbeat; None: create a new one.

    Attributes:
        descriptor: file descriptor of the memory, which the other process inherits.

    Raises:
        SafetyError: the system does not provide the memory.
    """

    def __init__(self, memory: int | None = None) -> None:
        size = 8 * _FIELDS + _COMMAND_SIZE
        if memory is None:
            if sys.platform != "linux":
                raise SafetyError(
                    "The guard process needs Linux.",
                    "On loopback, disable it: safety.guard = false.",
                )
            memory = _new_memory(size)
        self.descriptor = memory
        shared = memoryview(mmap.mmap(memory, size))
        # A store of 8 aligned bytes is atomic, so neither side reads half a number.
        self._fields = shared[: 8 * _FIELDS].cast("q")
        self._command = shared[8 * _FIELDS :]

    def begin_write(self, command: bytes, now: int) -> None:
        """Store a command and the time, ns of CLOCK_MONOTONIC, before it is written."""
        self._command[:] = command
        self._fields[_WRITING] = now

    def end_write(self, *, sent: bool) -> None:
        """Store that the write has ended, and whether the command was sent.

        The time of a write is its begin. The stream may lose its CPU between the packet and here.
        """
        if sent:
            self._fields[_LAST_WRITE] = self._fields[_WRITING]
        self._fields[_WRITING] = 0

    @property
    def writing(self) -> bool:
        """Whether a write is in progress."""
        return bool(self._fields[_WRITING])

    @property
    def last_write(self) -> int:
        """When the last write that has ended began, ns of CLOCK_MONOTONIC; 0: nothing to damp.

        During the first write, it is the begin of that write, because the robot may have received
        the command.
        """
        return self._fields[_LAST_WRITE] or self._fields[_WRITING]

    def clear(self) -> None:
        """Store that the robot is damped, so that the guard does not take over."""
        self._fields[_LAST_WRITE] = 0

    @property
    def command(self) -> bytes:
        """The last command; after an interrupted copy, it has joints of the previous one."""
        return bytes(self._command)

    @property
    def takeover(self) -> Takeover:
        """Why the guard damps the robot; NONE if it does not."""
        return Takeover(self._fields[_TAKEOVER])

    @takeover.setter
    def takeover(self, why: Takeover) -> None:
        self._fields[_TAKEOVER] = why

    @property
    def subscribers(self) -> int:
        """Number of subscribers of LowCmd that the guard has matched before the first command."""
        return self._fields[_SUBSCRIBERS]

    @subscribers.setter
    def subscribers(self, number: int) -> None:
        self._fields[_SUBSCRIBERS] = number

    def close(self) -> None:
        """Free the file descriptor; the memory is freed with the object."""
        os.close(self.descriptor)


def _new_memory(size: int) -> int:
    """Create memory that a child process can inherit; return its file descriptor."""
    try:
        memory = os.memfd_create("g1stream-heartbeat")
        os.truncate(memory, size)
    except OSError as error:
        raise SafetyError(
            f"No memory can be shared with the guard process: {error.strerror}.",
            "Check the limits on open files and memory with `ulimit -a`.",
        ) from error
    return memory


class Watch:
    """Decides from the heartbeat when the guard takes over.

    A stopped or ended process is detected by its state, soon after its last command. A running
    process is replaced after a silence. The lateness of the guard's own wake-ups does not count as
    silence, because the whole machine has stalled then, and the stream may be healthy.

    Args:
        limit: silence after which a running stream is replaced, ns.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._last_write = self._own_lateness = 0

    def judge(self, now: int, due: int, last_write: int, state: Callable[[], Takeover]) -> Takeover:
        """Decide whether to take over, and why.

        Args:
            now: time, ns.
            due: scheduled time of this check, ns.
            last_write: time in the heartbeat, ns; 0: nothing to damp.
            state: returns NONE, ENDED or STOPPED from the state of the process.
        """
        if last_write != self._last_write:
            self._last_write, self._own_lateness = last_write, 0
        self._own_lateness += max(0, now - max(due, last_write))
        silence = now - last_write
        if not last_write or silence < _STATE_CHECK:
            return Takeover.NONE
        late = silence - self._own_lateness >= self._limit
        return state() or (Takeover.SILENT if late else Takeover.NONE)

    def next_look(self, now: int) -> int:
        """Time of the next check, ns."""
        if now - self._last_write < _STATE_CHECK:
            return self._last_write + _STATE_CHECK
        limit = self._last_write + self._limit + self._own_lateness
        return min(now + _CHECK_PERIOD, limit) if limit > now else now + _CHECK_PERIOD


class GuardedLoop(Protocol):
    """Interface of a loop that a guard protects.

    Attributes:
        damped: whether the last command damped; also true before the first one.
    """

    damped: bool

    def end_for_error(self, stop: Stop) -> None:
        """End the run through DAMP, unless it is already ending."""


class Guard:
    """Context manager that runs the guard process of this process's stream.

    The guard starts while everything else is prepared. A stream does not begin without it, and ends
    if it fails. On loopback, it can be disabled.

    Args:
        config: settings of the stream, including those that `for_wire` sets.
        participant: the participant that sends the commands.

    Attributes:
        heartbeat: heartbeat for the link that publishes the commands; None without a guard.

    Raises:
        ConfigError: the guard is disabled, and a robot may be commanded.
        SafetyError: this system does not support a guard.
        ChildError: the guard process cannot be started.
    """

    def __init__(self, config: Config, participant: Participant) -> None:
        self._participant = participant
        sockets = participant.sockets
        self._loop: GuardedLoop | None = None
        self._failure = ""
        self._began = False
        self._child: Child | None = None
        self.heartbeat: Heartbeat | None = None
        self._end_timeout = _END_TIMEOUT + config.stream.damp
        if config.safety.guard:
            self.heartbeat = Heartbeat()
            memory = self.heartbeat.descriptor
            self._child = Child(
                "guard",
                _settings(config, memory, sockets)._asdict(),
                pass_fds=(memory, *sockets),
                on_failure=self._fail,
            )
        elif not is_local_only(config.dds.interface):
            raise ConfigError(
                f"safety.guard = false, but a robot may be on {config.dds.interface}.",
                "Remove this setting: without the guard process, a killed stream does not damp.",
            )

    def wait_until_ready(self) -> None:
        """Wait until the guard process watches the heartbeat, before the first command.

        Raises:
            ChildError: the guard process failed or was not ready in time.
        """
        if self._child:
            self._child.wait_until_ready()

    @contextmanager
    def protecting(self, loop: GuardedLoop) -> Iterator[None]:
        """Context manager that protects a running loop; afterwards only if it has not damped."""
        self._loop, self._began = loop, True
        if self._failure:  # the guard failed before the loop existed
            self._fail(self._failure)
        try:
            yield
        finally:
            self._loop = None
            if self.heartbeat and loop.damped:
                self.heartbeat.clear()

    def __enter__(self) -> Guard:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._child and self._began:
                self._child.finish(timeout=self._end_timeout)
            elif self._child:  # it may still be starting
                self._child.kill(at_once=True)
        except ChildError as error:
            _LOGGER.warning("%s", error.cause)
        finally:
            if self.heartbeat:
                if self.heartbeat.takeover:
                    self._participant.cut_off()
                self.heartbeat.close()

    def _fail(self, cause: str) -> None:
        self._failure = cause
        loop = self._loop
        if loop is None or (self.heartbeat and self.heartbeat.takeover):
            return
        loop.end_for_error(Stop("guard", f"the guard process failed: {cause.rstrip('.')}"))


class _Settings(NamedTuple):
    """Settings of the guard process.

    Attributes:
        memory: file descriptor of the heartbeat.
        sockets: file descriptors of the stream's DDS sockets.
        stream: process id of the stream.
        domain, interface: DDS domain and network interface.
        priority: SCHED_FIFO priority.
        limit: silence after which a running stream is replaced, ns.
        period: time between two damping commands, ns.
        via, damp: as of `load_receiver`.
    """

    memory: int
    sockets: Sequence[int]
    stream: int
    domain: int
    interface: str
    priority: int
    limit: int
    period: int
    via: Via
    damp: float


def _settings(config: Config, memory: int, sockets: Sequence[int]) -> _Settings:
    settings, wire, priority = config.stream, config.dds, config.realtime.priority
    limit = max(_ROBOT_SILENCE, 2.0 / settings.rate)
    if is_local_only(wire.interface):
        limit = config.safety.state_timeout
    return _Settings(
        memory=memory,
        sockets=tuple(sockets),
        stream=os.getpid(),
        domain=wire.domain,
        interface=wire.interface,
        priority=priority + 1,  # also where the loop has none, and may not get the CPU
        limit=round(limit * 1e9),
        period=settings.period,
        via=settings.via,
        damp=settings.damp,
    )


def _run_child(parent: Parent) -> None:
    """Watch the stream that started this process, and damp the robot if the stream cannot."""
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP, signal.SIGCHLD}:
        with suppress(OSError):  # reserved by the C library
            signal.signal(number, signal.SIG_IGN)
    settings = _Settings(**parent.startup_message)
    heartbeat = Heartbeat(settings.memory)
    allow_all_cpus()  # a process that takes the stream's CPU must not take the guard's
    with Participant(settings.domain, settings.interface) as participant:
        receiver = load_receiver(settings.via, settings.period, settings.damp)
        commands = RawWriter(participant, receiver.topic, user_data=IDLE)
        events = dds_log_handler(participant, GUARD)
        scheduled = on_time(settings.priority, helpers=participant.threads)
        # Another receiver, because a receiver knows its last command.
        rehearse = partial(_rehearse, load_receiver(settings.via, settings.period, settings.damp))
        with handled_by(events, ConsoleHandler()), scheduled:
            rehearse()
            parent.ready()
            if why := _watch(parent, heartbeat, settings, commands.subscribers, rehearse):
                _end(heartbeat, settings, receiver, commands, why)


def _watch(
    parent: Parent,
    heartbeat: Heartbeat,
    settings: _Settings,
    subscribers: Callable[[], int],
    rehearse: Callable[[], None],
) -> Takeover:
    """Wait until the guard has to take over; NONE if the stream has ended and damped."""
    watch, due = Watch(settings.limit), time.monotonic_ns()
    while not parent.done.wait(max(0.0, (due - time.monotonic_ns()) / 1e9)):
        now, last_write = time.monotonic_ns(), heartbeat.last_write
        if not last_write:
            heartbeat.subscribers = subscribers()
            due = now + _DISCOVERY_PERIOD
        elif why := watch.judge(now, due, last_write, partial(_state, settings.stream)):
            return why
        else:
            due = watch.next_look(now)
            if due - last_write >= settings.limit:  # the last look before a takeover
                rehearse()
        parent.beat()
    return Takeover.ENDED if heartbeat.last_write else Takeover.NONE


def _state(pid: int) -> Takeover:
    """Whether a process has ended or is stopped; NONE if it runs."""
    state = process_state(pid)
    if state in ("", "Z", "X"):
        return Takeover.ENDED
    return Takeover.STOPPED if state in "Tt" else Takeover.NONE


def _rehearse(receiver: Receiver) -> None:
    """Run the slow parts of a takeover. Code that has not run for a second takes some ms."""
    command = LowCmd()
    command.load(command.tobytes())
    next(receiver.end(command))
    with suppress(OSError), _here(os.getpid()):
        pass


def _fence(heartbeat: Heartbeat, settings: _Settings, why: Takeover) -> None:
    """Prevent the replaced stream from sending anything more.

    A send that waits, and each later one, fails, however long the write around it takes. A packet
    that the kernel is sending now still goes out. For that the stream must run on a CPU, so this
    waits for it; a process that is stopped is not within such a send.
    """
    for descriptor in settings.sockets:
        # Linux shuts down the sending of a UDP socket, and reports that there is no connection.
        with suppress(OSError), socket.socket(fileno=descriptor) as shared:
            shared.shutdown(socket.SHUT_WR)
    if why is Takeover.SILENT and heartbeat.writing:
        with suppress(OSError), _here(settings.stream):  # the stream may be killed meanwhile
            end = time.monotonic() + _WRITE_TIMEOUT
            while heartbeat.writing and time.monotonic() < end:
                time.sleep(_WRITE_POLL)


@contextmanager
def _here(pid: int) -> Iterator[None]:
    """Context manager that moves all threads of a process to the CPU of this thread.

    This CPU has time for them. A thread that may also run on other CPUs is not moved immediately,
    and would wait in the queue of a busy CPU.
    """
    # proc(5): the CPU is field 39; the name, field 2, may have spaces.
    stat = Path("/proc/thread-self/stat").read_text().rpartition(")")[2].split()
    here, before = {int(stat[39 - 3])}, {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):  # the thread has ended meanwhile
            before[int(task.name)] = os.sched_getaffinity(int(task.name))
            os.sched_setaffinity(int(task.name), here)
    try:
        yield
    finally:
        for task_id, cpus in before.items():
            with suppress(OSError):
                os.sched_setaffinity(task_id, cpus)


def _end(
    heartbeat: Heartbeat,
    settings: _Settings,
    receiver: Receiver,
    commands: RawWriter,
    why: Takeover,
) -> None:
    def send(frame: bytes) -> None:
        with suppress(DDSException):  # the next write may succeed
            commands.write(frame)

    silence = time.monotonic_ns() - heartbeat.last_write
    heartbeat.takeover = why
    _fence(heartbeat, settings, why)
    last = LowCmd()
    last.load(heartbeat.command)
    frames = receiver.end(last)
    send(next(frames))
    with suppress(DDSException):
        commands.announce(PUBLISHING)
    _LOGGER.error(
        "the guard %s: g1stream stream (pid %d) %s, %.0f ms after its last command",
        receiver.ending,
        settings.stream,
        why,
        silence / 1e6,
    )
    clock = SystemClock()
    for _, frame in zip(Ticker(clock, settings.period, clock.now()), frames, strict=False):
        send(frame)


if __name__ == "__main__":
    run_child(_run_child)
