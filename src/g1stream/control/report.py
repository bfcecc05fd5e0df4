"""The counters of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from g1stream.robot.joints import N_JOINTS, by_joint
from g1stream.session.records import FeedForwardChange, Percentiles, StreamSummary
from g1stream.types import Ints

if TYPE_CHECKING:
    from g1stream.control.commands import CommandLimits
    from g1stream.control.feedforward import FeedForward
    from g1stream.control.targets import Ramp
    from g1stream.session.records import BalanceSummary
    from g1stream.types import FeedForwardKind, StreamSupport

__all__ = ["Lateness", "LoopReport"]


class Lateness:
    """A histogram of lateness in microseconds, of a size that does not grow with the run.

    Bins are 1 us wide up to 20 ms; the last one holds everything later. The newest lateness and the
    maximum are exact.
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
    """The counters of a run, whatever ended it.

    Attributes:
        period: ns between deadlines.
        limits: of the commands; they count what they have changed.
        saturated: (29,) ticks at which each joint's feed-forward torque was held at its limit.
        reason: why it ended early; empty when the motion was played to its end.
        feedforward, support: of the commands, and how the robot was taken to be held; None until
            RAMP begins.
        feedforward_changes: when the torque was switched off and on again, in order.
        preview: how far commands are ahead of the reference, s; None until RAMP begins.
        balance: of a robot on its feet.
        robot: name of the model that torques were computed with.
        time_scale: median of simulated over real time, as measured.
        command_delay: longest time that commands waited in a queue of the robot's end, s; 0: none,
            None: unknown.
        commands: LowCmds written.
        states: LowStates received, of those that were the newest at a tick.
        crc_errors: of these, how many were dropped because of a wrong CRC.
        first_stamp, last_stamp: publish times of the first and last LowCmd, ns since the epoch.
        ramp: the way to the first frame; None until it begins.
        played: length of PLAY, ns; 0 until it ends.
        delay: by which the motion ended later because of stalls, ns.
        skipped: ticks left out because they were a whole period late or more.
        worst_work: longest time from a write to the end of the tick's computation, ns.
        lateness: of each write against its deadline.
    """

    period: int
    limits: CommandLimits
    saturated: Ints = field(default_factory=lambda: np.zeros(N_JOINTS, np.int64))
    reason: str = ""
    feedforward: FeedForwardKind | None = None
    support: StreamSupport | None = None
    feedforward_changes: list[FeedForwardChange] = field(default_factory=list)
    preview: float | None = None
    balance: BalanceSummary | None = None
    robot: str | None = None
    time_scale: float | None = None
    command_delay: float | None = None
    commands: int = 0
    states: int = 0
    crc_errors: int = 0
    first_stamp: int = 0
    last_stamp: int = 0
    ramp: Ramp | None = None
    played: int = 0
    delay: int = 0
    skipped: int = 0
    worst_work: int = 0
    lateness: Lateness = field(default_factory=Lateness)

    def begin(self, feedforward: FeedForward) -> None:
        """Take what a feed-forward has decided on, and its counters."""
        self.feedforward = feedforward.kind
        self.support = feedforward.support
        self.preview = feedforward.preview
        self.saturated, self.feedforward_changes = feedforward.saturated, feedforward.changes

    @property
    def rate(self) -> float | None:
        """LowCmds per second between the first and the last, Hz; None before the second."""
        span = self.last_stamp - self.first_stamp
        return (self.commands - 1) * 1e9 / span if span > 0 else None

    def summary(self) -> StreamSummary:
        """The counters as a record for people and files."""
        late = self.lateness
        percentiles = None
        if late.n:
            p50, p99, p99_9 = map(late.percentile_us, (50.0, 99.0, 99.9))
            percentiles = Percentiles(p50=p50, p99=p99, p99_9=p99_9, max=late.maximum_ns / 1e3)
        return StreamSummary(
            reason=self.reason,
            commands=self.commands,
            rate_hz=self.rate,
            nominal_rate_hz=1e9 / self.period,
            lateness_us=percentiles,
            skipped_ticks=self.skipped,
            worst_work_us=self.worst_work / 1e3,
            ramp_s=self.ramp.length if self.ramp else None,
            ramp_speed_rad_s=self.ramp.peak_speed if self.ramp else None,
            ramp_joint=self.ramp.joint if self.ramp else None,
            delay_s=self.delay / 1e9,
            clamped_ticks=by_joint(self.limits.clamped.tolist()),
            speed_limited_ticks=by_joint(self.limits.speed_limited.tolist()),
            torque_limited_ticks=by_joint(self.limits.torque_limited.tolist()),
            saturated_ticks=by_joint(self.saturated.tolist()),
            feedforward=self.feedforward,
            support=self.support,
            preview_s=self.preview,
            feedforward_changes=self.feedforward_changes,
            balance=self.balance,
            robot=self.robot,
            time_scale=self.time_scale,
            command_delay_s=self.command_delay,
            states_used=self.states,
            states_wrong_crc=self.crc_errors,
            lateness_histogram_us=late.sparse(),
        )
