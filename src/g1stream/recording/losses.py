"""Counts the samples that were published and did not come.

Two independent witnesses: DDS numbers the samples of each writer and tells what it missed on the
way, and some messages carry a number of their own, which also shows what was lost after that.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.dds.topics import LOWSTATE, REFERENCE
from g1stream.recording.samples import Samples

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from g1stream.recording.receiver import Batch

__all__ = ["Counter", "Losses"]

#: A number that leaps further was not lost on the way: its publisher was started anew.
_JUMP: Final = 10_000
#: Steps to have seen before it is known by how much a number grows.
_ENOUGH: Final = 8

#: The field that numbers the samples. LowState's is 0 for ever on one of the simulators; then
#: nothing can be known from it.
_NUMBERED: Final = {topic.name: (topic, "tick") for topic in (REFERENCE, LOWSTATE)}


@dataclass
class Counter:
    """Finds holes in the number that each sample of one writer carries.

    Attributes:
        step: by how much the number grows from one sample to the next; 0 until it is known.
    """

    step: int = 0
    _last: int | None = None
    _early: list[NDArray[np.int64]] = field(default_factory=list)

    def count(self, numbers: NDArray[np.int64]) -> int:
        """How many samples are missing between the (T,) numbers, and before them."""
        steps = np.diff(numbers if self._last is None else np.append(self._last, numbers))
        self._last = int(numbers[-1])
        if not self.step:
            self._early.append(steps)
            steps = np.concatenate(self._early)
            forward = steps[steps > 0]
            if forward.size < _ENOUGH:
                return 0
            self.step = int(np.median(forward))
            self._early.clear()
        missed = steps // self.step - 1
        return int(missed[(missed > 0) & (missed < _JUMP)].sum())


class Losses:
    """What is known to be missing, by DDS topic.

    Attributes:
        missing: samples, by topic name.
    """

    def __init__(self) -> None:
        self.missing: dict[str, int] = {}
        self._counters: dict[tuple[str, int], Counter] = defaultdict(Counter)
        self._by_number: dict[str, int] = defaultdict(int)

    def look(self, name: str, batch: Batch) -> None:
        """Look through the numbers of a batch, oldest sample first, of each writer by itself."""
        if name not in _NUMBERED:
            return
        topic, path = _NUMBERED[name]
        numbers = Samples(topic, batch.data)[path].astype(np.int64)
        writers = np.array(batch.writers)
        for writer in np.unique(writers):
            missed = self._counters[name, int(writer)].count(numbers[writers == writer])
            self._by_number[name] += missed

    def update(self, lost: Mapping[str, int]) -> dict[str, int]:
        """Join what both witnesses say.

        Args:
            lost: samples that DDS says were lost so far, by topic name.

        Returns:
            How many more are missing than at the last update, where any are.
        """
        news = {}
        for name, by_dds in lost.items():
            missing = max(by_dds, self._by_number[name])
            if missing > self.missing.get(name, 0):
                news[name] = missing - self.missing.get(name, 0)
            self.missing[name] = missing
        return news
