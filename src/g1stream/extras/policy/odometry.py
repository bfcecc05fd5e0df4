"""Position and velocity of the pelvis: the robot's own estimate, or leg odometry without one.

In leg odometry (Roston and Krotkov, "Dead reckoning navigation for walking robots", IROS 1992), the
lowest corner of the soles is assumed to be at rest, so the pelvis's movement follows from the legs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.dds.messages import SportModeState
from g1stream.robot.rotations import quat_from_yaw, quat_rotate, yaw_of
from g1stream.robot.soles import Soles

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["OF_BASE", "Odometry"]

OF_BASE: Final = ("base_lin_vel", "motion_anchor_pos_b")
"""Terms that LowState does not contain."""


class Odometry:
    """Position and velocity of the pelvis in the world of the IMU, on a floor at height 0.

    Args:
        robot: the robot.

    Attributes:
        pos: (3,) m; x and y are 0 at the first update, and z follows from the legs.
        vel: (3,) m/s.
        newest: returns the newest SportModeState that the robot has published since the last call,
            or None. One that is not finite is ignored.
    """

    def __init__(self, robot: G1) -> None:
        self._soles, self._state = Soles(robot), SportModeState()
        self._corners: Floats | None = None
        self._place: Floats | None = None  # in the world of SportModeState, m
        self.pos, self.vel = np.zeros(3), np.zeros(3)
        self.newest: Callable[[], bytes | None] = lambda: None

    def update(self, joint_pos: Floats, quat_wxyz: Floats, passed: float) -> None:
        """Update the estimate with a state.

        Args:
            joint_pos: (29,) rad, motor order.
            quat_wxyz: (4,) pelvis to world.
            passed: time since the state before, s.
        """
        corners = self._soles.path(joint_pos[None], np.zeros((1, 3)), quat_wxyz[None])[0]
        moved = np.zeros(3)
        if self._corners is not None and passed > 0.0:
            stands = int(np.argmin((corners + self._corners)[:, 2]))
            moved = self._corners[stands] - corners[stands]
            self.vel = moved / passed
        before, self._place, state = self._place, None, self._state
        if data := self.newest():
            state.load(data)
            place, vel, own = (
                one.astype(np.float64) for one in (state.position, state.velocity, state.quaternion)
            )
            if np.isfinite([*place, *vel, *own]).all():
                turn = quat_from_yaw(yaw_of(quat_wxyz) - yaw_of(own if own.any() else quat_wxyz))
                self._place, self.vel = place, quat_rotate(turn, vel)
                if before is not None:
                    moved = quat_rotate(turn, place - before)
        self.pos, self._corners = self.pos + moved, corners
        self.pos[2] = -corners[:, 2].min()
