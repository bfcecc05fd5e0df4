"""What the motion asks for at one instant; pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.robot.joints import N_JOINTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.motion.trajectory import TrajectoryPoint

__all__ = ["Target"]

_N: Final = N_JOINTS
_NO_TORQUE: Final = np.zeros(N_JOINTS)


class _Part:
    """A stretch of a target's values under a name of its own."""

    def __init__(self, start: int, length: int) -> None:
        self._where = slice(start, start + length)

    def __get__(self, target: Any, _: type | None = None) -> NDArray[np.float64]:
        part: NDArray[np.float64] = target.values[self._where]
        return part


@dataclass(frozen=True)
class Target:
    """What the motion asks for at one instant, as one row of numbers with names for its parts.

    One row, because a control loop then copies it into a message at once.

    Attributes:
        motion_time: s since the motion's first frame.
        values: (135,) the parts below, one after the other; those that a Reference publishes come
            first, in its order.
        q, dq, ddq, tau: (29,) rad, rad/s, rad/s^2, Nm, motor order.
        root_pos: (3,) m, world.
        root_quat_wxyz: (4,) pelvis to world.
        root_lin_vel: (3,) m/s, world.
        root_ang_vel: (3,) rad/s, pelvis frame.
        root_lin_acc: (3,) m/s^2, world, without gravity; not published.
        root_ang_acc: (3,) rad/s^2, pelvis frame, the time derivative of `root_ang_vel`; not
            published.
        published: (129,) those before them.
    """

    motion_time: float
    values: NDArray[np.float64]

    q = _Part(0, _N)
    dq = _Part(_N, _N)
    ddq = _Part(2 * _N, _N)
    tau = _Part(3 * _N, _N)
    root_pos = _Part(4 * _N, 3)
    root_quat_wxyz = _Part(4 * _N + 3, 4)
    root_lin_vel = _Part(4 * _N + 7, 3)
    root_ang_vel = _Part(4 * _N + 10, 3)
    root_lin_acc = _Part(4 * _N + 13, 3)
    root_ang_acc = _Part(4 * _N + 16, 3)
    published = _Part(0, 4 * _N + 13)

    @staticmethod
    def of(time: float, point: TrajectoryPoint) -> Target:
        """The target at the time of a sample of the motion, s, without torque."""
        values = np.concatenate(
            (
                point.joint_pos,
                point.joint_vel,
                point.joint_acc,
                _NO_TORQUE,
                point.root_pos,
                point.root_quat_wxyz,
                point.root_lin_vel,
                point.root_ang_vel,
                point.root_lin_acc,
                point.root_ang_acc,
            )
        )
        values.setflags(write=False)  # others are given the same one
        return Target(time, values)

    def but(self, **parts: NDArray[np.float64] | float) -> Target:
        """The same with other values in the named parts."""
        other = Target(self.motion_time, self.values.copy())
        for name, values in parts.items():
            getattr(other, name)[:] = values
        return other

    def at_rest(self) -> Target:
        """The same pose, with no velocity, acceleration or torque."""
        moving = ("root_lin_vel", "root_ang_vel", "root_lin_acc", "root_ang_acc")
        return self.but(dq=0.0, ddq=0.0, tau=0.0, **dict.fromkeys(moving, 0.0))
