"""Steps of this host's clock, and its offset from those of other hosts.

Nothing here corrects anything: log and publish times are kept as they are.
"""

from __future__ import annotations

import time
from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["ClockReading", "DelayEstimator", "StepDetector", "read_clocks"]

_SECOND: Final = 1_000_000_000
_MIN_STEP: Final = 2_000_000


class ClockReading(NamedTuple):
    """Both clocks of this machine at one instant, ns."""

    realtime: int
    monotonic: int


def read_clocks() -> ClockReading:
    """Read both clocks at nearly the same instant: the closest of several readings."""
    readings = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(5)]
    before, realtime, after = min(readings, key=lambda one: one[2] - one[0])
    return ClockReading(realtime, (before + after) // 2)


@dataclass
class StepDetector:
    """Detects when CLOCK_REALTIME is set, by its offset from CLOCK_MONOTONIC.

    Slewing, as NTP does at up to 0.5 ms a second, is not a step; it shows in the difference between
    `first` and `last`.

    Attributes:
        first, last: realtime minus monotonic at the first and the last reading, ns.
        steps: (when by the clock after it, by how much), ns each.
    """

    first: int | None = None
    last: int = 0
    steps: list[tuple[int, int]] = field(default_factory=list)

    def observe(self, reading: ClockReading) -> int:
        """By how much the clock was set since the previous reading, ns; 0 when it was not.

        Args:
            reading: at most some tenths of a second after the previous one.
        """
        offset = reading.realtime - reading.monotonic
        if self.first is None:
            self.first = self.last = offset
        step, self.last = offset - self.last, offset
        if abs(step) < _MIN_STEP:
            return 0
        self.steps.append((reading.realtime, step))
        return step


class DelayEstimator:
    """Estimates the delay of one topic's messages: the median of log time minus publish time.

    From another host this is the transit time plus the offset between the two clocks, which cannot
    be separated in one direction. In a wired network the transit takes well below 1 ms, so more
    than that is offset.

    Keeps one median for each second.
    """

    def __init__(self) -> None:
        self._medians = array("q")
        self._recent: list[NDArray[np.int64]] = []
        self._since: int | None = None

    def observe(self, log_times: NDArray[np.int64], publish_times: NDArray[np.int64]) -> None:
        """Take in a batch of T > 0 messages: (T,) ns since the epoch each."""
        self._recent.append(log_times - publish_times)
        if self._since is None:
            self._since = int(log_times[0])
        if abs(int(log_times[-1]) - self._since) >= _SECOND:
            self._medians.append(self._recent_median())
            self._recent.clear()
            self._since = int(log_times[-1])

    @property
    def seconds(self) -> int:
        """How many seconds have a median."""
        return len(self._medians)

    def median(self) -> int | None:
        """The median delay, ns; None before the first message."""
        if self._medians:
            return int(np.median(self._medians))
        return self._recent_median() if self._recent else None

    def _recent_median(self) -> int:
        return int(np.median(np.concatenate(self._recent)))
