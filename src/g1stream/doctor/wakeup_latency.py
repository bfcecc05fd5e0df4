"""A short trial of how punctually this machine wakes the loop, without the loop and the wire."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.clock import SystemClock
from g1stream.control.ticker import Lateness, Ticker
from g1stream.doctor.facts import Punctuality
from g1stream.realtime import on_time

if TYPE_CHECKING:
    from g1stream.clock import Clock
    from g1stream.config import RealtimeConfig

__all__ = ["TRIAL", "try_waking", "wake"]

TRIAL: Final = 0.5
"""How long the trial lasts, s; a machine that stops for longer makes it so much longer."""


def try_waking(realtime: RealtimeConfig, rate: float, seconds: float = TRIAL) -> Punctuality:
    """Ask to be woken at absolute deadlines with the rights the loop gets, and do nothing else.

    The priority is one below the loop's: a loop that runs meanwhile, maybe on the same isolated
    CPU, comes first, and the trial delays no command of it.

    Args:
        realtime: what the loop asks of the system.
        rate: deadlines per second, Hz.
        seconds: for how long.
    """
    clock = SystemClock()
    with on_time(max(0, realtime.priority - 1), realtime.cpu):
        return wake(clock, round(1e9 / rate), round(seconds * rate))


def wake(clock: Clock, period: int, deadlines: int) -> Punctuality:
    """Let a clock wake this thread at so many deadlines, `period` ns apart, and say how it did."""
    ticker = Ticker(clock, period, clock.now() + period)
    lateness, asked = Lateness(), 0
    for due, _ in ticker:
        # Of the deadline that was slept for, not of the one that came in its place.
        lateness.add(clock.now() - (ticker.start + asked * period))
        asked = due + 1
        if asked >= deadlines:
            break
    return Punctuality(
        rate=1e9 / period,
        deadlines=asked,
        missed=ticker.skipped,
        usual_ns=round(lateness.percentile_us(50.0) * 1000.0),
        worst_ns=lateness.maximum_ns,
    )
