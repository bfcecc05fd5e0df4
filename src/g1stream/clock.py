"""The clocks that loops run by, as one thing that a test can replace."""

import ctypes
import time
from typing import Protocol

__all__ = ["Clock", "SystemClock"]


class Clock(Protocol):
    """The clocks a loop needs, so that a test can bring its own."""

    def now(self) -> int:
        """CLOCK_MONOTONIC, ns; paces the loop."""

    def stamp(self) -> int:
        """CLOCK_REALTIME, ns since the epoch; stamps what goes out."""

    def sleep_until(self, deadline: int) -> None:
        """Sleep until `now()` has reached `deadline`."""


class SystemClock:
    """The clocks of this machine."""

    def __init__(self) -> None:
        _tighten_timer_slack()

    def now(self) -> int:
        """CLOCK_MONOTONIC, ns."""
        return time.monotonic_ns()

    def stamp(self) -> int:
        """CLOCK_REALTIME, ns since the epoch."""
        return time.time_ns()

    def sleep_until(self, deadline: int) -> None:
        """Sleep until `now()` has reached `deadline`; signals are handled on the way."""
        while (left := deadline - time.monotonic_ns()) > 0:
            time.sleep(left / 1e9)


def _tighten_timer_slack() -> None:
    """Ask the kernel to wake this thread 1 ns late at the most instead of 50 us (prctl(2))."""
    set_timerslack = 29
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(set_timerslack, ctypes.c_ulong(1))
