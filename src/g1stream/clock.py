"""Clocks of a real-time loop, behind an interface that tests can replace, and its deadlines."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Clock", "SystemClock", "Ticker", "have_one_clock"]

#: Longest time of a message on its way, ns.
_SLOWEST_WIRE: Final = 20_000_000
#: Longest busy wait before a deadline, ns.
_LONGEST_SPIN: Final = 100_000
#: Number of wake-ups over which their latency is averaged.
_AVERAGED: Final = 16


def have_one_clock(transit: int) -> bool:
    """Whether publisher and receiver of a message seem to have one clock.

    No message arrives before it is sent, and few take longer than 20 ms.

    Args:
        transit: time of reception minus publish time, ns.
    """
    return 0 <= transit <= _SLOWEST_WIRE


class Clock(Protocol):
    """Interface of the clocks that a loop needs."""

    def now(self) -> int:
        """CLOCK_MONOTONIC, ns; for deadlines."""

    def stamp(self) -> int:
        """CLOCK_REALTIME, ns since the epoch; for timestamps of messages."""

    def sleep_until(self, deadline: int) -> None:
        """Sleep until `now()` has reached `deadline`."""


class SystemClock:
    """The clocks of this machine.

    A thread that sleeps until a deadline wakes up about 50 us after it, because of the latency of
    the timer interrupt, the scheduler and Python. The clock measures that latency, sets the alarm
    earlier by its average, and busy-waits until the deadline.
    """

    def __init__(self) -> None:
        self._early = 0

    def now(self) -> int:
        return time.monotonic_ns()

    def stamp(self) -> int:
        return time.time_ns()

    def sleep_until(self, deadline: int) -> None:
        alarm = deadline - self._early
        asleep = False
        while (left := alarm - time.monotonic_ns()) > 0:
            asleep = True
            time.sleep(left / 1e9)
        if asleep:
            late = min(time.monotonic_ns() - alarm, _LONGEST_SPIN)
            self._early += (late - self._early) // _AVERAGED
        while time.monotonic_ns() < deadline:
            pass


@dataclass
class Ticker:
    """Iterator over the ticks of a loop at absolute deadlines, start + k * period.

    A tick that is late by a period or more is skipped in favour of the newest one whose deadline
    has passed, so that a delay never ends in a burst.

    Attributes:
        clock: provides now and sleep_until.
        period: ns between deadlines.
        start: the first deadline, ns.
        skipped: number of skipped ticks.
    """

    clock: Clock
    period: int
    start: int
    skipped: int = 0

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Yield (k, deadline) without end."""
        k = 0
        while True:
            self.clock.sleep_until(self.start + k * self.period)
            due = (self.clock.now() - self.start) // self.period
            self.skipped += due - k
            yield due, self.start + due * self.period
            k = due + 1
