"""Where the pelvis of a standing robot is, from its legs and its IMU; pure.

Soles that stand do not move. So the joints of the legs say where the pelvis is and how fast it
moves, and the IMU how it is turned. The accelerometer is fresher and less noisy than the joints'
speeds: the velocity follows it at once, and the legs within `_FOLLOWS` (a complementary filter).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from g1stream.control.reading import ImuReading
from g1stream.extras.feet.standing import Terms
from g1stream.robot.dynamics import GRAVITY
from g1stream.robot.rotations import quat_from_yaw, quat_mul, quat_rotate, wrap_angle
from g1stream.types import Floats

#: Time constants, s: of the velocity; of the heading, which a gyroscope lets drift by degrees a
#: minute; of a sole that does not stand where it was put, because it slipped.
_FOLLOWS: Final = 0.03
_HEADING: Final = 2.0
_SLIPPED: Final = 1.0
_GRAVITY: Final = np.array([0.0, 0.0, GRAVITY])


class BaseEstimate:
    """Position, velocity and heading of the pelvis in the world of the reference.

    Attributes:
        soles: (2, 3) m, where the middle of each sole stands.
        pos: (3,) m, of the pelvis.
        vel: (3,) m/s.
        quat_wxyz: (4,) pelvis to world.
    """

    def __init__(self) -> None:
        self.soles, self._headings = np.zeros((2, 3)), np.zeros(2)
        self._floor = 0.0
        self._drift = 0.0  # heading of the IMU's world in the reference's, rad
        self._begins = True  # the next LowState says where it is, without a history
        self.pos, self.vel = np.zeros(3), np.zeros(3)
        self.quat_wxyz = np.array([1.0, 0.0, 0.0, 0.0])

    def begin(self, soles: Floats, headings: Floats) -> None:
        """Set where the soles (2, 3) stand, m, and their headings (2,), rad."""
        self.soles, self._headings = soles.copy(), headings.copy()
        self._floor = float(soles[:, 2].mean())
        self._begins = True
        self.vel = np.zeros(3)

    def turn(self, imu: ImuReading) -> Floats:
        """Take the attitude of a reading over, and return it in the reference's world."""
        back = quat_from_yaw(-self._drift)
        self.quat_wxyz = quat_mul(back, imu.quat_wxyz.astype(np.float64))
        return self.quat_wxyz

    def update(self, terms: Terms, imu: ImuReading, load: Floats, passed: float) -> None:
        """Take a LowState into account, `passed` s after the last one.

        The terms are of the pelvis as turned last; `load` (2,) is what each foot carries, in sum 1;
        0 of a foot that is lifted.
        """
        headings = np.arctan2(terms.turns[:, 1, 0], terms.turns[:, 0, 0])
        turned = wrap_angle(headings - self._headings)
        error = float(load @ turned)
        by_legs = -load @ terms.sole_vel
        if self._begins:  # the error is that of a heading from which the drift is already taken
            self._drift, self.vel, self._begins = self._drift + error, by_legs, False
        else:
            self._drift += error * min(1.0, passed / _HEADING)
            acc = quat_rotate(self.quat_wxyz, imu.accelerometer.astype(np.float64)) - _GRAVITY
            self.vel = self.vel + passed * acc
            self.vel = self.vel + (by_legs - self.vel) * min(1.0, passed / _FOLLOWS)
        self.pos = load @ (self.soles - terms.soles)
        slipped = self.pos + terms.soles - self.soles
        self.soles = self.soles + slipped * (passed / _SLIPPED)
        lifted = load == 0.0  # it stands where it comes down
        self.soles[lifted, :2] += slipped[lifted, :2] * (1.0 - passed / _SLIPPED)
        self.soles[lifted, 2] = self._floor
        self._headings[lifted] += turned[lifted]
