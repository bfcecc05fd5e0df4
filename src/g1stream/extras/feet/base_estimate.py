"""Estimate of a standing robot's pelvis pose from its legs and its IMU.

Standing soles do not move, so the leg joints give the position and velocity of the pelvis, and the
IMU gives its attitude. The accelerometer has less delay and noise than the joint velocities, so the
velocity follows it at once and the legs within `_FOLLOWS` (a complementary filter).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from g1stream.control.reading import ImuReading
from g1stream.extras.feet.standing import Terms
from g1stream.robot.dynamics import GRAVITY
from g1stream.robot.rotations import quat_from_yaw, quat_mul, quat_rotate, wrap_angle
from g1stream.types import Floats

#: Time constants, s: of the velocity; of the heading, because a gyroscope drifts by degrees a
#: minute; of a sole that has slipped from its place.
_FOLLOWS: Final = 0.03
_HEADING: Final = 2.0
_SLIPPED: Final = 1.0
_GRAVITY: Final = np.array([0.0, 0.0, GRAVITY])


class BaseEstimate:
    """Position, velocity and heading of the pelvis in the world of the reference.

    Attributes:
        soles: (2, 3) m, place of the middle of each sole.
        pos: (3,) m, position of the pelvis.
        vel: (3,) m/s.
        quat_wxyz: (4,) pelvis to world.
    """

    def __init__(self) -> None:
        self.soles, self._headings = np.zeros((2, 3)), np.zeros(2)
        self._floor = 0.0
        self._drift = 0.0  # heading of the IMU's world in the reference's, rad
        self._begins = True  # the next LowState sets the place, without a history
        self.pos, self.vel = np.zeros(3), np.zeros(3)
        self.quat_wxyz = np.array([1.0, 0.0, 0.0, 0.0])

    def begin(self, soles: Floats, headings: Floats) -> None:
        """Set where the soles (2, 3) stand, m, and their headings (2,), rad."""
        self.soles, self._headings = soles.copy(), headings.copy()
        self._floor = float(soles[:, 2].mean())
        self._begins = True
        self.vel = np.zeros(3)

    def turn(self, imu: ImuReading) -> Floats:
        """Update the attitude from a reading, and return it in the reference's world."""
        back = quat_from_yaw(-self._drift)
        self.quat_wxyz = quat_mul(back, imu.quat_wxyz.astype(np.float64))
        return self.quat_wxyz

    def update(self, terms: Terms, imu: ImuReading, load: Floats, passed: float) -> None:
        """Update the estimate with a LowState, `passed` s after the last one.

        The terms are for the attitude of the last `turn`. `load` (2,) is the fraction on each foot,
        with sum 1; 0 for a lifted foot.
        """
        headings = np.arctan2(terms.turns[:, 1, 0], terms.turns[:, 0, 0])
        turned = wrap_angle(headings - self._headings)
        error = float(load @ turned)
        by_legs = -load @ terms.sole_vel
        if self._begins:  # the heading already has the drift subtracted
            self._drift, self.vel, self._begins = self._drift + error, by_legs, False
        else:
            self._drift += error * min(1.0, passed / _HEADING)
            acc = quat_rotate(self.quat_wxyz, imu.accelerometer.astype(np.float64)) - _GRAVITY
            self.vel = self.vel + passed * acc
            self.vel = self.vel + (by_legs - self.vel) * min(1.0, passed / _FOLLOWS)
        self.pos = load @ (self.soles - terms.soles)
        slipped = self.pos + terms.soles - self.soles
        self.soles = self.soles + slipped * (passed / _SLIPPED)
        lifted = load == 0.0  # its place is where it comes down
        self.soles[lifted, :2] += slipped[lifted, :2] * (1.0 - passed / _SLIPPED)
        self.soles[lifted, 2] = self._floor
        self._headings[lifted] += turned[lifted]
