"""Report of a run: counters, lateness, and ticks that the loop misses."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.control.lowstate import state_timeout
from g1stream.control.stop import Stop
from g1stream.control.tracking_error import RunningError
from g1stream.robot.joints import by_joint
from g1stream.session.records import BalanceSummary, Percentiles, StreamSummary
from g1stream.types import Ints, Phase

if TYPE_CHECKING:
    from g1stream.config import SafetyConfig
    from g1stream.control.feedforward import FeedForward
    from g1stream.control.limits import CommandLimits
    from g1stream.control.lowstate import LowStateChecks
    from g1stream.control.schedule import Schedule
    from g1stream.profiles import ProfileConstants

__all__ = ["Lateness", "LoopReport", "Overruns"]

_LOGGER = logging.getLogger(__name__)

#: Time over which missed ticks are counted, and interval of warnings about them, ns.
_SECOND: Final = 1_000_000_000
#: Interval of log messages about short overruns, which are usual on a busy machine, ns.
_LOG_INTERVAL: Final = 10_000_000_000
#: Length of an overrun above which it is a warning, ns; a servo may hold its target this long.
_LONG_OVERRUN: Final = 20_000_000


class Lateness:
    """A histogram of lateness in microseconds, of fixed size.

    Bins are 1 us wide up to 20 ms; the last one contains all later ticks. The newest lateness and
    the maximum are exact.
    """

    _BINS = 20_001

    def __init__(self) -> None:
        self.counts: Ints = np.zeros(self._BINS, dtype=np.int64)
        self.newest_ns = self.maximum_ns = 0
        self.n = 0

    def add(self, lateness_ns: int) -> None:
        """Count one tick."""
        self.n += 1
        self.newest_ns = lateness_ns
        self.maximum_ns = max(self.maximum_ns, lateness_ns)
        self.counts[min(max(lateness_ns, 0) // 1000, self._BINS - 1)] += 1

    def percentile_us(self, percent: float) -> float:
        """The lateness that `percent` of the ticks do not exceed, us; nan without ticks."""
        if not self.n:
            return float("nan")
        rank = max(1, int(np.ceil(self.n * percent / 100.0)))
        bin_index = int(np.searchsorted(np.cumsum(self.counts), rank))
        maximum = self.maximum_ns / 1000.0
        return maximum if bin_index == self._BINS - 1 else min(bin_index + 1.0, maximum)

    def sparse(self) -> dict[int, int]:
        """The nonempty bins: lower edge in us -> count."""
        return {int(i): int(self.counts[i]) for i in np.flatnonzero(self.counts)}


@dataclass
class LoopReport:
    """Counters of a run, however it ended, and the parts of the loop with further results.

    Attributes:
        period: time between deadlines, ns.
        schedule: the ramp, and why the run ended early.
        limits: limits of the commands, with counts of their changes.
        feedforward: feed-forward of the commands.
        checks: checks of LowState, with counts of the dropped ones.
        commands: number of LowCmds written.
        states: number of LowStates that were the newest at a tick.
        first_sent, last_sent: when the first and last LowCmd were written, ns of CLOCK_MONOTONIC.
        played: length of PLAY, ns; 0 until it ends.
        delay: time by which the motion ended later because of stalls, ns.
        waited: time by which it ended later because it follows the robot's time, ns.
        skipped: number of ticks that were skipped because they were late by a period or more.
        worst_work: longest time from a write to the end of the tick's computation, ns.
        lateness: lateness of each write relative to its deadline.
        error: tracking error of the LowStates that were used in PLAY.
    """

    period: int
    schedule: Schedule
    limits: CommandLimits
    feedforward: FeedForward
    checks: LowStateChecks
    commands: int = 0
    states: int = 0
    first_sent: int = 0
    last_sent: int = 0
    played: int = 0
    delay: int = 0
    waited: int | None = None
    skipped: int = 0
    worst_work: int = 0
    lateness: Lateness = field(default_factory=Lateness)
    error: RunningError = field(default_factory=RunningError)

    @property
    def stop(self) -> Stop | None:
        """Why the run ended early; None during the run and after the end of the motion."""
        return self.schedule.state.stop

    @property
    def rate(self) -> float | None:
        """LowCmds per second between the first and the last, Hz; None before the second."""
        span = self.last_sent - self.first_sent
        return (self.commands - 1) * 1e9 / span if span > 0 else None

    def summary(self, **about: Any) -> StreamSummary:
        """The counters as a record for output and files; `about` has the remaining fields."""
        late, ramp, feed = self.lateness, self.schedule.ramp, self.feedforward
        mode, margins = feed.mode, feed.status.margins
        percentiles = None
        if late.n:
            p50, p99, p99_9 = map(late.percentile_us, (50.0, 99.0, 99.9))
            percentiles = Percentiles(p50=p50, p99=p99, p99_9=p99_9, max=late.maximum_ns / 1e3)
        return StreamSummary(
            reason=self.stop.text if self.stop else "",
            stop=self.stop.kind if self.stop else None,
            signal=self.stop.signal if self.stop else None,
            commands=self.commands,
            rate_hz=self.rate,
            nominal_rate_hz=1e9 / self.period,
            lateness_us=percentiles,
            skipped_ticks=self.skipped,
            worst_work_us=self.worst_work / 1e3,
            ramp_s=ramp.length / 1e9 if ramp else None,
            ramp_speed_rad_s=ramp.peak_speed if ramp else None,
            ramp_joint=ramp.joint if ramp else None,
            delay_s=self.delay / 1e9,
            waited_s=None if self.waited is None else self.waited / 1e9,
            clamped_ticks=by_joint(self.limits.position.clamped.tolist()),
            speed_limited_ticks=by_joint(self.limits.speed.limited.tolist()),
            torque_limited_ticks=by_joint(self.limits.torque.limited.tolist()),
            saturated_ticks=by_joint(feed.saturated.tolist()),
            feedforward=mode.kind,
            support=mode.support,
            preview_s=feed.preview if mode.kind else None,
            feedforward_changes=feed.changes,
            balance=BalanceSummary.model_validate(margins) if margins else None,
            robot=mode.robot,
            time_scale=feed.robot_clock.median,
            states_used=self.states,
            states_wrong_crc=self.checks.crc_errors,
            lateness_histogram_us=late.sparse(),
            **about,
        )


class Overruns:
    """Counts ticks that were skipped because they were late by a period or more.

    Args:
        period: time between ticks, ns.
        config, constants: the thresholds.
    """

    def __init__(self, period: int, config: SafetyConfig, constants: ProfileConstants) -> None:
        self._ticks_per_second = _SECOND / period
        self._share = constants.max_missed_ticks
        self._timeout, self._timeout_words = state_timeout(config)
        self._recent: deque[tuple[int, int]] = deque()
        self._skipped = 0
        self._longest = self._logged = 0
        self._logged_at = -_LOG_INTERVAL

    def count(self, now: int, skipped: int, phase: Phase) -> None:
        """Update the number of ticks skipped until `now`, ns, and log the new ones.

        They are logged immediately, then every 10 s, or every second if one is long; in DONE, all
        of them are logged.
        """
        if new := skipped - self._skipped:
            self._skipped = skipped
            self._recent.append((now, new))
        while self._recent and now - self._recent[0][0] >= _SECOND:
            self._recent.popleft()
        level, interval = logging.INFO, _LOG_INTERVAL
        if self._longest >= _LONG_OVERRUN:
            level, interval = logging.WARNING, _SECOND
        early = now < self._logged_at + interval and phase is not Phase.DONE
        if skipped == self._logged or early:
            return
        new, self._logged, self._logged_at = skipped - self._logged, skipped, now
        self._longest = 0
        _LOGGER.log(
            level, "overrun: %d ticks skipped since the last message, %d in total", new, skipped
        )

    def stalled(self, gap: int) -> Stop | None:
        """Why the session must end after deadlines were missed for `gap` ns, or None."""
        self._longest = max(self._longest, gap)
        if gap / 1e9 <= self._timeout:
            return None
        return Stop(
            "loop",
            f"the loop stalled for {gap / 1e9:.3f} s on this machine ({self._timeout_words})",
        )

    def stop(self) -> Stop | None:
        """Why the session must end because of the ticks missed in the last second, or None."""
        missed = sum(new for _, new in self._recent)
        if missed <= self._share * self._ticks_per_second:
            return None
        return Stop(
            "loop",
            f"the loop missed {missed} of {self._ticks_per_second:.0f} ticks within a second on "
            f"this machine (limit {self._share:.0%} of them)",
        )
