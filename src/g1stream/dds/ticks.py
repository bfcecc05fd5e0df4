"""Lost samples, counted by the ticks of those that arrived."""

from __future__ import annotations

from collections import Counter

__all__ = ["TickGaps"]

_WRAP = 2**32
#: A step of more samples than this is no loss: the publisher started anew.
_MAX_LOST = 10_000


class TickGaps:
    """Counts samples and, from the steps of their ticks, those that never came.

    Publishers differ in what a tick is: a robot or bridge counts milliseconds by its own step, and
    one of the simulators leaves it 0. So the step that is seen most is taken for that between two
    neighbours. Memory does not grow with what is counted beyond the number of different steps.

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
    def missed(self) -> int | None:
        """How many samples were published and did not come; None where the tick cannot tell."""
        usual = self.step
        if usual is None:
            return None
        lost = ((step // usual - 1, count) for step, count in self._steps.items() if step)
        return sum(number * count for number, count in lost if number < _MAX_LOST)
