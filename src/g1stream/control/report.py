"""What the loop counts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from g1stream.control.ticker import Lateness
from g1stream.robot.joints import N_JOINTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.feedforward import Change

__all__ = ["LoopReport"]


@dataclass
class LoopReport:
    """How a run went, whatever ended it.

    Attributes:
        reason: why it ended early; empty when the motion was played to its end.
        period: ns between deadlines.
        commands: LowCmds written.
        states: LowStates received, of those that were the newest at a tick.
        first_stamp, last_stamp: publish times of the first and last LowCmd, ns since the epoch.
        skipped: ticks left out because they were a whole period late or more.
        lateness: of each write against its deadline.
        worst_work: longest time from a write to the end of the tick's computation, ns.
        clamped: (29,) ticks at which each joint's target was held at its limit.
        feedforward, support: what commands carried, and how the robot was taken to be held.
        feedforward_changes: when the torque went and came back, in order.
        saturated: (29,) ticks at which each joint's feed-forward torque was held at its limit.
    """

    period: int
    clamped: NDArray[np.int64]
    reason: str = ""
    feedforward: str = ""
    support: str = ""
    feedforward_changes: list[Change] = field(default_factory=list)
    saturated: NDArray[np.int64] = field(default_factory=lambda: np.zeros(N_JOINTS, np.int64))
    commands: int = 0
    states: int = 0
    first_stamp: int = 0
    last_stamp: int = 0
    skipped: int = 0
    worst_work: int = 0
    lateness: Lateness = field(default_factory=Lateness)

    @property
    def rate(self) -> float:
        """LowCmds per second between the first and the last, Hz; nan before the second."""
        span = self.last_stamp - self.first_stamp
        return (self.commands - 1) * 1e9 / span if span > 0 else float("nan")
