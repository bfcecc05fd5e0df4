"""Ticks that the loop misses: logged, and a reason to stop where they are too many."""

from __future__ import annotations

import logging
from collections import deque
from typing import TYPE_CHECKING, Final

from g1stream.control.state_checks import state_timeout
from g1stream.types import Phase

if TYPE_CHECKING:
    from g1stream.config import SafetyConfig

__all__ = ["Overruns"]

_LOGGER = logging.getLogger(__name__)

#: Missed ticks are counted over this time, and logged this often, ns.
_SECOND: Final = 1_000_000_000
#: A servo holds its last target for that long without harm, ns; a longer overrun is a warning.
_LONG_OVERRUN: Final = 20_000_000


class Overruns:
    """Counts ticks that were skipped because they were a whole period late or more.

    Args:
        period: ns between ticks.
        config: the thresholds.
    """

    def __init__(self, period: int, config: SafetyConfig) -> None:
        self._ticks_per_second = _SECOND / period
        self._share = config.max_missed_ticks
        self._timeout, self._timeout_words = state_timeout(config)
        self._recent: deque[tuple[int, int]] = deque()
        self._skipped = 0
        self._longest = self._logged = self._next_log = 0

    def count(self, now: int, skipped: int, phase: Phase) -> None:
        """Take the number of ticks skipped so far, at `now`, ns, and log those that are new.

        They are logged at once, then at most once a second; in DONE, all of them.
        """
        if new := skipped - self._skipped:
            self._skipped = skipped
            self._recent.append((now, new))
        while self._recent and now - self._recent[0][0] >= _SECOND:
            self._recent.popleft()
        if skipped == self._logged or (now < self._next_log and phase is not Phase.DONE):
            return
        new, self._logged, self._next_log = skipped - self._logged, skipped, now + _SECOND
        level = logging.WARNING if self._longest >= _LONG_OVERRUN else logging.INFO
        self._longest = 0
        _LOGGER.log(level, "overrun: ticks skipped: %d, %d in total", new, skipped)

    def stalled(self, gap: int) -> str:
        """Why the session must end after deadlines were missed for `gap` ns, or ""."""
        self._longest = max(self._longest, gap)
        if gap / 1e9 <= self._timeout:
            return ""
        return f"the loop stalled for {gap / 1e9:.3f} s on this machine ({self._timeout_words})"

    def verdict(self) -> str:
        """Why the session must end because of the ticks missed in the last second, or ""."""
        missed = sum(new for _, new in self._recent)
        if missed <= self._share * self._ticks_per_second:
            return ""
        return (
            f"the loop missed {missed} of {self._ticks_per_second:.0f} ticks within a second on "
            f"this machine (limit safety.max_missed_ticks = {self._share:g} of them); a "
            "lower stream.rate needs less CPU time"
        )
