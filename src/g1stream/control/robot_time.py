"""The robot's time, which is not the clock's in a simulator that is short of CPU; pure."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.reading import STALE, ticks_between

if TYPE_CHECKING:
    from g1stream.control.reading import Reading
    from g1stream.types import Floats

__all__ = ["RobotTime", "TimeScale"]

#: By how much a motion may be ahead of the robot's time or behind it, ns: more than ticks jitter.
_SLACK: Final = 10_000_000
#: A motion that waited catches up by this in a tick at most, ns.
_CATCH_UP: Final = 20_000_000
_NS_PER_MS: Final = 1_000_000
_STALE: Final = round(STALE * 1e9)


class RobotTime:
    """How long a motion has to wait, so that it keeps to the robot's time.

    The ticks of LowState count ms of that time: in Unitree's C++ simulator, in g1stream's and on
    the robot. Where they stand still, as in Unitree's Python simulator, the time passes at the
    measured scale, and not at all while no LowState arrives.

    Attributes:
        delay: by which the motion is behind the clock, ns; it may become less again. Whoever delays
            the motion for another reason adds to it.
    """

    def __init__(self) -> None:
        self.delay = 0
        self._last: Reading | None = None
        self._start: int | None = None
        self._passed = 0  # of the robot's time since then
        self._ticks = False

    def begin(self, now: int) -> None:
        """The motion begins at `now`, ns."""
        self.delay, self._start, self._passed = 0, now, 0

    def add(self, measured: Reading, scale: float) -> None:
        """Take a LowState into account; `scale` is simulated over real time."""
        last, self._last = self._last, measured
        if last is None:
            return
        ticks = ticks_between(last.tick, measured.tick)
        self._ticks = self._ticks or ticks != 0
        if self._ticks:
            self._passed += max(0, ticks) * _NS_PER_MS
        else:
            self._passed += round(min(measured.received - last.received, _STALE) * scale)

    def wait(self, now: int) -> int:
        """By how much the motion waits more than at the call before, ns; negative: less."""
        if self._start is None or self._last is None:
            return 0
        age = min(now - self._last.received, _SLACK)
        behind = now - self._start - self._passed - age
        before = self.delay
        self.delay = min(max(before, behind - _SLACK), max(behind + _SLACK, before - _CATCH_UP))
        return self.delay - before


class TimeScale:
    """How fast the robot's time passes: a simulator that is short of CPU is slower than the clock.

    Estimates simulated over real time from measured joint positions and velocities.

    In a span of real time a joint moves by d, and its velocity, which is one of simulated time,
    integrates to x over real time: d = r x. With exponential forgetting over spans,

        r = sum(d . d) / sum(d . x)

    The displacement is the exact one of the two: the times at which velocities are sampled jitter,
    so that the quotient sum(d . x) / sum(x . x) would be biased.

    Attributes:
        value: the estimate r, within 0.5 and 1.05; 1 while nothing has moved.
    """

    _SPAN: Final = 0.1  # s: a simulator that stalls and catches up does both within it
    #: A span with a longer gap between readings is not used, s. Shorter ones are: a simulator that
    #: stalls and then catches up must be counted whole.
    _GAP: Final = 0.2
    #: Time constant of forgetting, s.
    _MEMORY: Final = 1.0
    #: Weight of r = 1 in both sums, rad²: far above the noise of encoders at rest.
    _PRIOR: Final = 1e-3
    _LOWEST: Final = 0.5
    _HIGHEST: Final = 1.05  # no simulator is faster than the clock for long
    #: Estimates that are kept for the median: an hour of them.
    _KEPT: Final = 36_000

    def __init__(self) -> None:
        self.value = 1.0
        self._estimates: deque[float] = deque(maxlen=self._KEPT)
        self._squares = self._products = 0.0
        self._start = self._last = -np.inf
        self._q = self._dq = self._integral = np.zeros(0)

    def add(self, measured: Reading) -> None:
        """Add a reading."""
        time = measured.received / 1e9
        q, velocity = measured.q.astype(np.float64), measured.dq.astype(np.float64)
        passed = time - self._last
        if passed <= 0.0 or passed > self._GAP:
            self._begin(time, q, velocity)
            return
        self._integral += (0.5 * passed) * (self._dq + velocity)
        self._last, self._dq = time, velocity
        if time - self._start >= self._SPAN:
            self._estimate(q, time - self._start)

    @property
    def median(self) -> float | None:
        """Of the estimates so far; None before the first one."""
        return median(self._estimates) if self._estimates else None

    def _begin(self, time: float, q: Floats, dq: Floats) -> None:
        self._start = self._last = time
        self._q, self._dq, self._integral = q, dq, np.zeros_like(q)

    def _estimate(self, q: Floats, passed: float) -> None:
        moved, kept = q - self._q, np.exp(-passed / self._MEMORY)
        square, product = float(moved @ moved), float(moved @ self._integral)
        if np.isfinite(square) and np.isfinite(product):
            self._squares = self._squares * kept + square
            self._products = self._products * kept + product
            scale = (self._squares + self._PRIOR) / max(self._products + self._PRIOR, 1e-9)
            self.value = min(self._HIGHEST, max(self._LOWEST, scale))
            self._estimates.append(scale)
        self._begin(self._last, q, self._dq)
