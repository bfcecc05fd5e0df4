"""Count lost samples by the ticks of the received ones."""

from __future__ import annotations

from collections import Counter

__all__ = ["TickGaps"]

_WRAP = 2**32
#: Step, in samples, above which the publisher was restarted and no samples were lost.
_MAX_LOST = 10_000


class TickGaps:
    """Counts received samples and, from the steps of their ticks, lost samples.

    The tick depends on the publisher. g1stream's bridge counts ms, with a constant step.
    unitree_mujoco's C++ bridge publishes more often than its simulated time advances, so ticks
    repeat and jump without a loss. Its Python bridge leaves the tick 0. Therefore `missed` is the
    number of lost samples only for g1stream's own publishers; for others, `jumps` is only a hint.
    Memory grows only with the number of different steps.

    Attributes:
        received: number of received samples.
        restarts: how often the tick went back because the publisher was restarted.
    """

    def __init__(self) -> None:
        self.received = 0
        self.restarts = 0
        self._last: int | None = None
        self._steps: Counter[int] = Counter()

    def add(self, tick: int) -> None:
        """Add a sample with this tick, uint32."""
        self.received += 1
        if self._last is not None:
            step = (tick - self._last) % _WRAP
            if step < _WRAP // 2:
                self._steps[step] += 1
            else:
                self.restarts += 1
        self._last = tick

    @property
    def step(self) -> int | None:
        """The most frequent step of the tick; None before the tick has changed."""
        moving = [(count, -step) for step, count in self._steps.items() if step]
        return -max(moving)[1] if moving else None

    @property
    def jumps(self) -> int:
        """Number of steps of at least twice the usual step."""
        usual = self.step
        return 0 if usual is None else sum(n for k, n in self._steps.items() if k >= 2 * usual)

    def missed(self, step: float) -> int:
        """Number of lost samples of a publisher with this step of the tick, 1 or more.

        Ticks are rounded down, so this is a lower bound.
        """
        steps = [(k, n) for k, n in self._steps.items() if k < _MAX_LOST * step]
        passed, received = sum(k * n for k, n in steps), sum(n for _, n in steps)
        return max(0, int((passed - 1) // step) + 1 - received)
