"""The clocks that loops run by, as one thing that a test can replace."""

import ctypes
import time
from typing import Final, Protocol

__all__ = ["Clock", "SystemClock"]

#: No more than this is ever waited out awake, ns.
_LONGEST_SPIN: Final = 100_000
#: Over how many wake-ups their lateness is averaged.
_MEMORY: Final = 16


class Clock(Protocol):
    """The clocks a loop needs, so that a test can bring its own."""

    def now(self) -> int:
        """CLOCK_MONOTONIC, ns; paces the loop."""

    def stamp(self) -> int:
        """CLOCK_REALTIME, ns since the epoch; stamps what goes out."""

    def sleep_until(self, deadline: int) -> None:
        """Sleep until `now()` has reached `deadline`."""


class SystemClock:
    """The clocks of this machine.

    A thread that sleeps until a deadline runs some 50 us after it: the way from the timer's
    interrupt through the scheduler into Python. The clock learns how long that takes, asks to be
    woken so much earlier, and waits out what is left.
    """

    def __init__(self) -> None:
        self._early = 0
        _tighten_timer_slack()

    def now(self) -> int:
        """CLOCK_MONOTONIC, ns."""
        return time.monotonic_ns()

    def stamp(self) -> int:
        """CLOCK_REALTIME, ns since the epoch."""
        return time.time_ns()

    def sleep_until(self, deadline: int) -> None:
        """Sleep until `now()` has reached `deadline`; signals are handled on the way."""
        alarm = deadline - self._early
        asleep = False
        while (left := alarm - time.monotonic_ns()) > 0:
            asleep = True
            time.sleep(left / 1e9)
        if asleep:
            late = min(time.monotonic_ns() - alarm, _LONGEST_SPIN)
            self._early += (late - self._early) // _MEMORY
        while time.monotonic_ns() < deadline:
            pass


def _tighten_timer_slack() -> None:
    """Ask the kernel to wake this thread 1 ns late at the most instead of 50 us (prctl(2))."""
    set_timerslack = 29
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(set_timerslack, ctypes.c_ulong(1))
