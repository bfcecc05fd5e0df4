"""The fraction of the weight on the feet, estimated from leg torques."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.joints import JOINT_GROUPS, N_JOINTS
from g1stream.robot.soles import SIDES, Soles

if TYPE_CHECKING:
    from g1stream.control.reading import Reading
    from g1stream.robot.model import G1

__all__ = ["FeetLoad"]

#: (2, 6) motor indices of each leg.
_JOINTS: Final = np.array([JOINT_GROUPS[f"{side}_leg"] for side in SIDES])
#: Joint angle step for the derivative of the foot's height, rad.
_TURN: Final = 1e-4


class FeetLoad:
    """Estimates the fraction of the weight on the feet of a robot at rest.

    At rest, motor torques tau, gravity torques g and a vertical force F on a foot at height z
    balance: tau + F dz/dq = g. Least squares over the joints of each leg gives its force.
    """

    def __init__(self, robot: G1) -> None:
        self._dynamics, self._soles = InverseDynamics(robot), Soles(robot)
        self._weight = self._dynamics.mass * self._dynamics.gravity

    def share(self, measured: Reading) -> float:
        """Fraction for both feet together: 0 in the air, 1 if nothing else supports the robot."""
        q, quat = (values.astype(np.float64) for values in (measured.q, measured.imu.quat_wxyz))
        rest = np.zeros(N_JOINTS)
        gravity = self._dynamics.solve("bolted", q, rest, rest, BaseMotion(quat, np.zeros(3))).tau
        turned = np.repeat(q[None], 1 + _JOINTS.size, axis=0)
        turned[np.arange(_JOINTS.size) + 1, _JOINTS.ravel()] += _TURN
        quats = np.repeat(quat[None], len(turned), axis=0)
        corners = self._soles.path(turned, np.zeros((len(turned), 3)), quats)
        heights = corners[..., 2].reshape(len(turned), 2, -1).mean(axis=2)
        lifts = (heights[1:] - heights[0]) / _TURN
        missing = gravity - measured.tau
        force = 0.0
        for foot, joints in enumerate(_JOINTS):
            lift = lifts.reshape(*_JOINTS.shape, -1)[foot, :, foot]
            force += float(lift @ missing[joints]) / float(lift @ lift)
        return force / self._weight
