"""The clocks of a loop, behind an interface that tests can replace."""

import time
from typing import Final, Protocol

__all__ = ["Clock", "SystemClock"]

#: Longest busy wait before a deadline, ns.
_LONGEST_SPIN: Final = 100_000
#: Number of wake-ups over which their latency is averaged.
_AVERAGED: Final = 16


class Clock(Protocol):
    """The clocks that a loop needs."""

    def now(self) -> int:
        """CLOCK_MONOTONIC, ns; for deadlines."""

    def stamp(self) -> int:
        """CLOCK_REALTIME, ns since the epoch; for timestamps of messages."""

    def sleep_until(self, deadline: int) -> None:
        """Sleep until `now()` has reached `deadline`."""


class SystemClock:
    """The clocks of this machine.

    A thread that sleeps until a deadline wakes up some 50 us after it: the latency of the timer
    interrupt, the scheduler and Python. The clock measures that latency, sets the alarm earlier by
    its average, and busy-waits for the rest.
    """

    def __init__(self) -> None:
        self._early = 0

    def now(self) -> int:
        """CLOCK_MONOTONIC, ns."""
        return time.monotonic_ns()

    def stamp(self) -> int:
        """CLOCK_REALTIME, ns since the epoch."""
        return time.time_ns()

    def sleep_until(self, deadline: int) -> None:
        """Sleep until `now()` has reached `deadline`; signals are handled meanwhile."""
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
