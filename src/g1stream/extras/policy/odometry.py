"""Leg odometry: position and velocity of the pelvis, estimated from the standing foot.

As in Roston and Krotkov, "Dead reckoning navigation for walking robots" (IROS 1992), the lowest
corner of the soles is assumed to be at rest, so the pelvis's movement follows from the legs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.soles import Soles

if TYPE_CHECKING:
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["OF_BASE", "LegOdometry"]

OF_BASE: Final = ("base_lin_vel", "motion_anchor_pos_b")
"""Terms that LowState does not contain."""


class LegOdometry:
    """Position and velocity of the pelvis in the world of the IMU, on a floor at height 0.

    Attributes:
        pos: (3,) m; x and y are 0 at the first update.
        vel: (3,) m/s.
    """

    def __init__(self, robot: G1) -> None:
        self._soles = Soles(robot)
        self._before: Floats | None = None
        self.pos, self.vel = np.zeros(3), np.zeros(3)

    def update(self, joint_pos: Floats, quat_wxyz: Floats, passed: float) -> None:
        """Update the estimate with a state.

        Args:
            joint_pos: (29,) rad, motor order.
            quat_wxyz: (4,) pelvis to world.
            passed: time since the state before, s.
        """
        corners = self._soles.path(joint_pos[None], np.zeros((1, 3)), quat_wxyz[None])[0]
        if self._before is not None and passed > 0.0:
            stands = int(np.argmin((corners + self._before)[:, 2]))
            moved = self._before[stands] - corners[stands]
            self.pos, self.vel = self.pos + moved, moved / passed
        self.pos[2] = -corners[:, 2].min()
        self._before = corners
