"""Absolute deadlines t0 + k * period, and how well they are kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from g1stream.clock import Clock

__all__ = ["Lateness", "Ticker"]


class Lateness:
    """A histogram of lateness in microseconds, of a size that does not grow with the run.

    Bins are 1 us wide up to 20 ms; what is later than that shares the last one, of which only the
    maximum is known. The maximum is exact.
    """

    _BINS = 20_001

    def __init__(self) -> None:
        self.counts: NDArray[np.int64] = np.zeros(self._BINS, dtype=np.int64)
        self.maximum_ns = 0
        self.n = 0

    def add(self, lateness_ns: int) -> None:
        """Count one; a tick cannot be early."""
        self.n += 1
        self.maximum_ns = max(self.maximum_ns, lateness_ns)
        self.counts[min(max(lateness_ns, 0) // 1000, self._BINS - 1)] += 1

    def percentile_us(self, percent: float) -> float:
        """The lateness that `percent` of the ticks do not exceed, us; nan before the first."""
        if not self.n:
            return float("nan")
        rank = max(1, int(np.ceil(self.n * percent / 100.0)))
        bin_index = int(np.searchsorted(np.cumsum(self.counts), rank))
        maximum = self.maximum_ns / 1000.0
        return maximum if bin_index == self._BINS - 1 else min(bin_index + 1.0, maximum)

    def sparse(self) -> dict[int, int]:
        """The bins that are not empty: lower edge in us -> count."""
        return {int(i): int(self.counts[i]) for i in np.flatnonzero(self.counts)}


@dataclass
class Ticker:
    """Yields the ticks of a loop, each at its absolute deadline.

    A tick that would come a whole period late or more is skipped, not made up for: the newest whose
    deadline has passed comes in its place, so that neither work nor a sleep that took too long ends
    in a burst.

    Attributes:
        clock: now and sleep_until.
        period: ns between deadlines.
        start: the first deadline, ns.
        skipped: how many ticks were left out.
    """

    clock: Clock
    period: int
    start: int
    skipped: int = 0

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Yield (k, deadline) for ever; the caller breaks."""
        k = 0
        while True:
            self.clock.sleep_until(self.start + k * self.period)
            due = (self.clock.now() - self.start) // self.period
            self.skipped += due - k
            yield due, self.start + due * self.period
            k = due + 1
