"""The robot's time, which is slower than the clock in a simulator without enough CPU time. Pure."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.reading import STALE, ticks_between

if TYPE_CHECKING:
    from g1stream.control.reading import Reading
    from g1stream.types import Floats, Ints

__all__ = ["RobotClock", "counts_messages"]

#: Maximum difference of a motion from the robot's time, ns; above the jitter of ticks.
_SLACK: Final = 10_000_000
_NS_PER_MS: Final = 1_000_000
_STALE: Final = round(STALE * 1e9)
#: Maximum time between two readings that a motion follows, ns; LowState of 25 Hz. In a longer gap
#: the motors obeyed an old command, and the motion waits until the source has seen what that did.
_LONGEST: Final = 40_000_000
#: Readings that show whether ticks are a clock.
_FIRST: Final = 50
#: Ticks count messages if this share of them steps by 1 at a median interval longer than this, ns.
_BY_ONE, _LONGER_THAN_MS = 0.9, 1.6e6


def counts_messages(ticks: Ints, intervals: Ints) -> bool:
    """Whether the tick of LowState counts messages, not ms.

    A simulator that publishes each ms of its time, and runs at less than 0.6 of real time, looks
    the same; its pace is then the measured scale.

    Args:
        ticks: (N,) steps of the tick between readings.
        intervals: (N,) time between the same readings, ns.
    """
    longer = len(intervals) > 0 and float(np.median(intervals)) > _LONGER_THAN_MS
    return longer and float(np.mean(ticks == 1)) >= _BY_ONE


class RobotClock:
    """The robot's time: how fast it passes, and by how much a motion that follows it is behind.

    The ticks of LowState count ms of the robot's time in Unitree's C++ simulator, in g1stream's
    and on the robot. If they do not change, as in Unitree's Python simulator, or count messages, as
    in unitree_sim_isaaclab, the time passes at the measured scale. It stops while no LowState
    arrives. A motion does not follow long gaps, also if the robot went on meanwhile.

    The scale is the ratio of simulated to real time, from measured joint positions and velocities.
    In a span of real time a joint moves by d. Its velocity is measured in simulated time, and
    integrates to x over real time, so d = r x with the ratio r. With exponential forgetting over
    spans,

        r = sum(d . d) / sum(d . x)

    The displacement d is exact, but x is not, because the sampling times of velocities jitter.
    Therefore the quotient sum(d . x) / sum(x . x) would be biased.

    Args:
        scale: ratio of simulated to real time; None: it is measured.
        followed: whether the motion follows the robot's time, not the computer's.

    Attributes:
        followed: as given.
        time: the robot's time since the first reading, ns.
        scale: the ratio as given or measured, then within 0.5 and 1.05; 1 until something has
            moved.
        delay: time by which the motion is behind the computer's clock, ns; it may decrease again.
            Code that delays the motion for another reason must add that time here.
    """

    _SPAN: Final = 0.1  # s; a simulator stalls and catches up within this time
    #: Gap between readings above which a span is not used, s. Shorter gaps are used, because a
    #: stall must be counted together with the catching up.
    _GAP: Final = 0.2
    #: Time constant of forgetting, s.
    _MEMORY: Final = 1.0
    #: Weight of r = 1 in both sums, rad²; far above the noise of encoders at rest.
    _PRIOR: Final = 1e-3
    _LOWEST: Final = 0.5
    _HIGHEST: Final = 1.05  # no simulator is faster than the clock for long
    #: Number of estimates that are kept for the median; an hour.
    _KEPT: Final = 36_000

    def __init__(self, scale: float | None = None, *, followed: bool = False) -> None:
        self.followed = followed
        self.scale = 1.0 if scale is None else scale
        self.delay = 0
        self._last: Reading | None = None
        self.time = self._left_out = 0
        self._begun: tuple[int, int] | None = None  # in both times
        self._ticks = self._counted = False
        self._first: list[tuple[int, int]] = []  # ticks and ns between the first readings
        self._measures = scale is None
        self._estimates: deque[float] = deque(maxlen=self._KEPT)
        self._squares = self._products = 0.0
        self._span = self._added = -np.inf  # when the span began, and its newest reading, s
        self._q = self._dq = self._integral = np.zeros(0)

    def take(self, measured: Reading, *, moving: bool) -> None:
        """Process a reading; `moving`: commands move the joints, so that it shows the scale."""
        last, self._last = self._last, measured
        if last is not None:
            ticks, passed = ticks_between(last.tick, measured.tick), measured.arrived - last.arrived
            if len(self._first) < _FIRST:
                self._first.append((ticks, passed))
                self._counted = counts_messages(*np.array(self._first).T)
            self._ticks = self._ticks or ticks != 0
            counts_ms = self._ticks and not self._counted
            slowed = round(min(passed, _STALE) * self.scale)
            since = max(0, ticks) * _NS_PER_MS if counts_ms else slowed
            self.time += since
            self._left_out += max(0, since - _LONGEST)
        if self._measures and moving:
            self._integrate(measured)

    def begin(self, now: int) -> None:
        """Begin the motion at `now`, ns."""
        self.delay, self._begun = 0, (now, self.time - self._left_out)

    def wait(self, now: int) -> int:
        """Change of `delay` since the last call, ns; negative if the motion catches up."""
        if self._begun is None or self._last is None:
            return 0
        age = min(now - self._last.arrived, _SLACK)
        begun, robot_begun = self._begun
        behind = now - begun - (self.time - self._left_out - robot_begun) - age
        before = self.delay
        self.delay = min(max(before, behind - _SLACK), behind + _SLACK)
        return self.delay - before

    @property
    def median(self) -> float | None:
        """Median of the estimated scales so far; None before the first one."""
        return median(self._estimates) if self._estimates else None

    def _integrate(self, measured: Reading) -> None:
        """Add a reading to the span, and estimate the scale at its end."""
        time = measured.arrived / 1e9
        q, velocity = measured.q.astype(np.float64), measured.dq.astype(np.float64)
        passed = time - self._added
        if passed <= 0.0 or passed > self._GAP:
            self._begin_span(time, q, velocity)
            return
        self._integral += (0.5 * passed) * (self._dq + velocity)
        self._added, self._dq = time, velocity
        if time - self._span >= self._SPAN:
            self._estimate(q, time - self._span)

    def _begin_span(self, time: float, q: Floats, dq: Floats) -> None:
        self._span = self._added = time
        self._q, self._dq, self._integral = q, dq, np.zeros_like(q)

    def _estimate(self, q: Floats, passed: float) -> None:
        moved, kept = q - self._q, np.exp(-passed / self._MEMORY)
        square, product = float(moved @ moved), float(moved @ self._integral)
        if np.isfinite(square) and np.isfinite(product):
            self._squares = self._squares * kept + square
            self._products = self._products * kept + product
            scale = (self._squares + self._PRIOR) / max(self._products + self._PRIOR, 1e-9)
            self.scale = min(self._HIGHEST, max(self._LOWEST, scale))
            self._estimates.append(scale)
        self._begin_span(self._added, q, self._dq)
