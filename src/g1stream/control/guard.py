"""What the guard process of a stream knows of it, and when it damps the robot in its place.

The stream writes a heartbeat and a copy of each command into shared memory, the guard what it sends
instead; docs/safety.md explains the guard. Time comes in as an argument.
"""

from __future__ import annotations

import mmap
import os
import sys
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from g1stream.dds.layout import Layout
from g1stream.dds.messages import LowCmd
from g1stream.errors import SafetyError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["LOG_NAME", "Heartbeat", "Takeover", "Watch", "damping_command"]

LOG_NAME: Final = "guard"
"""The guard process logs under this name, and only when it damps."""

#: Silence after which the guard looks whether the stream is stopped or gone, ns.
_STATE_CHECK: Final = 20_000_000
#: Between two such looks, ns.
_CHECK_PERIOD: Final = 10_000_000

_COMMAND_SIZE: Final = Layout.of(LowCmd.idl_type).sample_size
#: The fields of the shared memory, each an int64; the last commands of both follow them.
_LAST_WRITE, _TAKEOVER, _SUBSCRIBERS, _FIELDS = range(4)


class Takeover(IntEnum):
    """Why the guard damps the robot."""

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
        memory: file descriptor of another process's heartbeat; a new one is made without it.

    Attributes:
        descriptor: of the memory, to be inherited by the other process.

    Raises:
        SafetyError: the system has no such memory.
    """

    def __init__(self, memory: int | None = None) -> None:
        size = 8 * _FIELDS + 2 * _COMMAND_SIZE
        if memory is None:
            if sys.platform != "linux":
                raise SafetyError(
                    "The guard process needs Linux.",
                    "On loopback, leave it out: safety.guard = false.",
                )
            memory = _new_memory(size)
        self.descriptor = memory
        shared = memoryview(mmap.mmap(memory, size))
        # A store of 8 aligned bytes is atomic: neither side ever reads half a number.
        self._fields = shared[: 8 * _FIELDS].cast("q")
        self._command = shared[8 * _FIELDS :][:_COMMAND_SIZE]
        self._replacement = shared[8 * _FIELDS + _COMMAND_SIZE :]

    def beat(self, command: bytes, now: int) -> None:
        """Note, before a command is written, what it is and when, ns of CLOCK_MONOTONIC."""
        self._command[:] = command
        self._fields[_LAST_WRITE] = now

    @property
    def last_write(self) -> int:
        """When the last command was written, ns of CLOCK_MONOTONIC; 0: there is none to damp."""
        return self._fields[_LAST_WRITE]

    def clear(self) -> None:
        """Note that the robot is damped, so that the guard has nothing to do."""
        self._fields[_LAST_WRITE] = 0

    @property
    def command(self) -> bytes:
        """The last command; an interrupted `beat` leaves joints of the one before it."""
        return bytes(self._command)

    @property
    def takeover(self) -> Takeover:
        """Why the guard damps the robot; NONE: it does not."""
        return Takeover(self._fields[_TAKEOVER])

    @property
    def replacement(self) -> bytes:
        """The guard's last command, for the stream to send as well; empty before its first one."""
        return bytes(self._replacement) if self._fields[_TAKEOVER] else b""

    def replace(self, command: bytes, why: Takeover) -> None:
        """Note, before the guard writes a command, what it is, and why the guard damps."""
        self._replacement[:] = command
        self._fields[_TAKEOVER] = why

    @property
    def subscribers(self) -> int:
        """Subscribers of LowCmd that the guard is matched with, before the first command."""
        return self._fields[_SUBSCRIBERS]

    @subscribers.setter
    def subscribers(self, number: int) -> None:
        self._fields[_SUBSCRIBERS] = number

    def close(self) -> None:
        """Free the file descriptor; the memory is freed with the object."""
        os.close(self.descriptor)


def _new_memory(size: int) -> int:
    """A file descriptor of memory that a child process can inherit."""
    try:
        memory = os.memfd_create("g1stream-heartbeat")
        os.truncate(memory, size)
    except OSError as error:
        raise SafetyError(
            f"No memory can be shared with the guard process: {error.strerror}.",
            "Look at the limits of this process with `ulimit -a`: open files and memory.",
        ) from error
    return memory


class Watch:
    """Decides from the heartbeat when to take over.

    A stopped or ended process is recognised by its state, soon after its last command. Where it
    runs, silence decides. How late the guard itself is woken up is not counted as silence: then the
    machine stalls, and the stream may not be worse off than the guard.

    Args:
        limit: silence after which a running stream is replaced, ns.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._last_write = self._own_lateness = 0

    def judge(self, now: int, due: int, last_write: int, state: Callable[[], Takeover]) -> Takeover:
        """Whether and why to take over.

        Args:
            now: ns.
            due: when the guard was to look, ns.
            last_write: of the heartbeat, ns; 0: there is nothing to damp.
            state: why the process sends nothing, by its state: NONE, ENDED or STOPPED.
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
        """When to look again, ns."""
        if now - self._last_write < _STATE_CHECK:
            return self._last_write + _STATE_CHECK
        limit = self._last_write + self._limit + self._own_lateness
        return min(now + _CHECK_PERIOD, limit) if limit > now else now + _CHECK_PERIOD


def damping_command(command: bytes, kd: float) -> bytes:
    """A sealed LowCmd that damps with gain `kd` where `command` was, N·m·s/rad."""
    damping = LowCmd()
    damping.load(command)
    damping.kp[:] = damping.dq[:] = damping.tau[:] = 0.0
    damping.kd[:] = kd * (damping.motor_mode == 1)  # nothing to a motor that is not there
    return damping.seal()
