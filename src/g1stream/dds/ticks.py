"""What the ticks of received samples say about those that did not arrive."""

from __future__ import annotations

from collections import Counter

__all__ = ["TickGaps"]

_WRAP = 2**32
#: A step of more samples than this is no loss: the publisher started anew.
_MAX_LOST = 10_000


class TickGaps:
    """Counts samples and, from the steps of their ticks, those that never came.

    Publishers differ in what a tick is: our own bridge counts milliseconds by its own step;
    unitree_mujoco's C++ bridge stamps simulated time faster than that advances, so that ticks
    repeat and jump without a loss; its Python bridge leaves the tick 0. So `missed` is a number of
    lost samples only where the publisher is our own; elsewhere `jumps` is a hint at most. Memory
    does not grow with what is counted beyond the number of different steps.

    Attributes:
        received: samples counted.
        restarts: how often the tick went back: the publisher started anew.
    """

    def __init__(self) -> None:
        self.received = 0
        self.restarts = 0
        self._last: int | None = None
        self._steps: Counter[int] = Counter()

    def add(self, tick: int) -> None:
        """Count a sample with this tick, uint32."""
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
        """The tick's usual step; None while it is not known or the tick stands still."""
        moving = [(count, -step) for step, count in self._steps.items() if step]
        return -max(moving)[1] if moving else None

    @property
    def jumps(self) -> int:
        """How many steps skipped at least one tick of the usual step."""
        usual = self.step
        return 0 if usual is None else sum(n for k, n in self._steps.items() if k >= 2 * usual)

    def missed(self, step: float) -> int:
        """How many samples did not come, of a publisher whose ticks are this far apart, 1 or more.

        A tick is rounded down. So many samples, at least, are in the time that has passed.
        """
        steps = [(k, n) for k, n in self._steps.items() if k < _MAX_LOST * step]
        passed, received = sum(k * n for k, n in steps), sum(n for _, n in steps)
        return max(0, int((passed - 1) // step) + 1 - received)
