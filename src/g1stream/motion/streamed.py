"""What the spline through a motion's frames asks for when it is streamed.

Between two frames it is faster than the frames tell, and it may go beyond both of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.motion.resample import resample
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.motion.motion import Motion
    from g1stream.robot.model import G1


__all__ = ["STREAM_RATE", "HeldJoint", "JointSpeed", "measure_streamed"]

#: LowCmds a second unless `stream.rate` says otherwise, Hz.
STREAM_RATE: Final = 500.0


@dataclass(frozen=True)
class JointSpeed:
    """A joint's speed at one time.

    Attributes:
        joint: its name.
        time: s from frame 0.
        value: rad/s, how fast, whichever way.
        limit: rad/s, the joint's velocity limit.
    """

    joint: str
    time: float
    value: float
    limit: float


@dataclass(frozen=True)
class HeldJoint:
    """A joint that is asked beyond its position limits, where the stream holds it.

    Attributes:
        joint: its name.
        n_targets: how many of its targets lie beyond a limit.
        time: s from frame 0, of the one that lies furthest beyond.
        value: rad, asked for there.
        limit: rad, the one that is passed there, where the joint is held.
    """

    joint: str
    n_targets: int
    time: float
    value: float
    limit: float


def measure_streamed(
    motion: Motion, robot: G1, rate: float, position_margin: float
) -> tuple[tuple[JointSpeed, ...], tuple[HeldJoint, ...]]:
    """The greatest speed of each joint, and the joints that would be held at a limit.

    Args:
        motion: with the robot's joints.
        robot: whose limits.
        rate: targets a second, Hz; they are taken at the times i / rate.
        position_margin: rad, kept from the position limits, as `safety.position_margin`.

    Returns:
        Speeds, the largest share of its limit first, and held joints, the furthest beyond first.
    """
    lower, upper = robot.lower + position_margin, robot.upper - position_margin
    n_joints = len(motion.joint_names)
    speed, excess = _Peaks(n_joints), _Peaks(n_joints)
    asked, n_held = np.zeros(n_joints), np.zeros(n_joints, dtype=np.int64)
    for numbers, samples in resample(motion, rate, 0, motion.n_frames):
        speed.see(np.abs(samples.joint_vel), numbers.start)
        beyond = np.maximum(lower - samples.joint_pos, samples.joint_pos - upper)
        n_held += (beyond > 0.0).sum(axis=0)
        further, row = excess.see(beyond, numbers.start)
        asked = np.where(further, samples.joint_pos[row, np.arange(n_joints)], asked)
    speeds = [
        JointSpeed(name, speed.at[j] / rate, float(speed.value[j]), float(robot.velocity[j]))
        for j, name in enumerate(motion.joint_names)
    ]
    held = [
        HeldJoint(
            motion.joint_names[j],
            int(n_held[j]),
            excess.at[j] / rate,
            float(asked[j]),
            float(lower[j] if asked[j] < lower[j] else upper[j]),
        )
        for j in np.flatnonzero(n_held)
    ]
    return (
        tuple(sorted(speeds, key=lambda s: -s.value / s.limit)),
        tuple(sorted(held, key=lambda h: -abs(h.value - h.limit))),
    )


class _Peaks:
    """The greatest value above 0 of each column so far, and the number of its row."""

    def __init__(self, n_columns: int) -> None:
        self.value: Floats = np.zeros(n_columns)
        self._at = np.zeros(n_columns, dtype=np.int64)

    @property
    def at(self) -> list[int]:
        """The numbers of the rows."""
        numbers: list[int] = self._at.tolist()
        return numbers

    def see(self, values: Floats, first: int) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
        """Take in rows of which `first` is the number of the first.

        Returns:
            Where a column has a new peak, and the row of each column's greatest value.
        """
        row, here = values.argmax(axis=0), values.max(axis=0)
        higher = here > self.value
        self._at = np.where(higher, first + row, self._at)
        self.value = np.maximum(here, self.value)
        return higher, row
