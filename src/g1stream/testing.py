"""Replacements for DDS, the clock and the robot, for tests of code that streams.

With `FakeClock` and `FakeLink` a loop runs in no time, and every sleep, command and timestamp can
be asserted to the nanosecond:

    clock = FakeClock()
    link = FakeLink(clock)
    loop = make_loop(plan(motion, config), link, clock)  # of g1stream.control
    loop.run()
    assert link.phases()["DAMP"] == 500

`Lockstep` is a link and a clock with the physics of our bridge behind it; `g1stream.rollout` wraps
it for whole sessions.

`dask_cluster` is a cluster on this machine, for tests of code that computes a library.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from g1stream.dds.messages import LowCmd, LowState, Reference
from g1stream.sim.lockstep import Lockstep
from g1stream.sim.robot import MODE_MACHINE_29
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["FakeClock", "FakeLink", "Lockstep", "Sent", "dask_cluster"]

_EPOCH: Final = 1_700_000_000_000_000_000


class FakeClock:
    """A clock whose time passes only by sleeping and by `work`.

    Args:
        limit: the longest time that may pass, ns; more is an AssertionError, so that a loop that
            does not end fails.

    Attributes:
        time: what `now` returns, ns.
        deadlines: the arguments of `sleep_until`, in order, also those that had passed.
        oversleeps: deadline -> how late the sleep until it ends, ns; 0 for all others.
    """

    def __init__(self, limit: int = 100_000_000_000) -> None:
        self.time = 5_000_000_000
        self.deadlines: list[int] = []
        self.oversleeps: dict[int, int] = {}
        self._end = self.time + limit

    def now(self) -> int:
        return self.time

    def stamp(self) -> int:
        return _EPOCH + self.time

    def sleep_until(self, deadline: int) -> None:
        self.deadlines.append(deadline)
        if deadline > self.time:
            self.time = deadline + self.oversleeps.get(deadline, 0)
        if self.time > self._end:
            raise AssertionError("the loop does not end")

    def work(self, duration: int) -> None:
        """Let time pass, ns, as a computation does."""
        self.time += duration


class Sent(NamedTuple):
    """One LowCmd with its Reference, as a `FakeLink` got them."""

    time: int  # ns of the clock
    stamp: int  # publish time, ns since the epoch
    command: LowCmd
    reference: Reference


class FakeLink:
    """An in-process link (`g1stream.control.link.Link`) with a robot that a test controls.

    Args:
        clock: the clock of the loop.

    Attributes:
        sent: what the loop has sent.
        robot: the robot's LowState, which the loop receives at every tick. It stands upright.
        silent: the robot publishes nothing but by `publish_state`.
        subscriber_count: of LowCmd.
        others: names of other publishers of LowCmd.
        publisher: identity of the publisher of LowState.
        state_others: names of the publishers of LowState, where there are several.
        guard_missing: why there is no guard process yet; "" if there is or none is needed.
        guard_took_over: why the guard process damps the robot; "" while it does not.
        announced: how the robot announces that it is held.
        on_send: called after each `send`, with the number of those before.
    """

    def __init__(self, clock: FakeClock) -> None:
        self.sent: list[Sent] = []
        self.robot = LowState()
        self.robot.quaternion[:] = (1.0, 0.0, 0.0, 0.0)
        self.robot.mode_machine[()] = MODE_MACHINE_29
        self.silent = False
        self.subscriber_count = 1
        self.others: list[str] = []
        self.publisher = 1
        self.state_others: list[str] = []
        self.guard_missing = self.guard_took_over = ""
        self.announced: str | None = None
        self.on_send: Callable[[int], object] = lambda n: None
        self._clock = clock
        self._published: bytes | None = None

    def subscribers(self) -> int:
        return self.subscriber_count

    def other_publishers(self) -> list[str]:
        return list(self.others)

    def support(self) -> str | None:
        return self.announced

    def model(self) -> str | None:
        return None

    def receive(self, state: LowState) -> int | None:
        data = self._published if self.silent else self.robot.tobytes()
        self._published = None
        if data is None:
            return None
        state.load(data)
        return self.publisher

    def state_publishers(self) -> list[str]:
        return list(self.state_others)

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        sent = Sent(self._clock.now(), stamp, LowCmd(), Reference())
        sent.command.load(command)
        sent.reference.load(reference)
        self.sent.append(sent)
        self.on_send(len(self.sent) - 1)
        return self._clock.now()

    def unguarded(self) -> str:
        return self.guard_missing

    def replaced(self) -> str:
        return self.guard_took_over

    def publish_state(self, data: bytes) -> None:
        """Let a silent robot publish one LowState."""
        self._published = data

    def at_send(self, n: int, act: Callable[[], object]) -> None:
        """Call `act` after the n-th command, counted from 0."""
        self.on_send = lambda i: act() if i == n else None

    def phases(self) -> dict[str, int]:
        """Number of commands by phase, in order of time."""
        return dict(Counter(Phase(int(sent.reference.phase)).name for sent in self.sent))

    def in_phase(self, phase: Phase) -> list[Sent]:
        """What was sent in a phase."""
        return [sent for sent in self.sent if int(sent.reference.phase) == phase]


@contextmanager
def dask_cluster(
    threads: int = 1, workers: int = 1
) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """A Dask scheduler and workers on loopback, as docs/scale.md starts them.

    Args:
        threads: of each worker.
        workers: how many.

    Yields:
        The scheduler's address, its process and those of the workers.
    """
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory, "scheduler.json")

        def start(*arguments: str) -> subprocess.Popen[bytes]:
            common = ("--scheduler-file", str(file), "--no-dashboard")
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments, *common],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )

        head = start("scheduler", "--host", "127.0.0.1", "--port", "0")
        many = [start("worker", "--no-nanny", "--nthreads", str(threads)) for _ in range(workers)]
        try:
            while not file.exists():
                if head.poll() is not None:
                    raise RuntimeError(f"dask scheduler ended with code {head.returncode}")
                time.sleep(0.05)
            yield json.loads(file.read_text())["address"], head, many
        finally:
            for process in (*many, head):
                process.kill()  # a worker that is to end in order waits for its scheduler
                process.wait()
