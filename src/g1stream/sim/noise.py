"""Noise of a simulated robot's sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.joints import N_JOINTS
from g1stream.robot.rotations import quat_normalize, quat_to_rpy

if TYPE_CHECKING:
    from g1stream.dds.messages import LowState

__all__ = ["SensorNoise"]

#: Standard deviations of joint positions, rad, and speeds, rad/s; of the gyroscope, rad/s, and the
#: accelerometer, m/s²; of the attitude about each axis, rad. They are assumed, not those of a robot
#: that was measured.
_POSITION: Final = 5e-4
_SPEED: Final = 0.05
_GYROSCOPE: Final = 0.01
_ACCELEROMETER: Final = 0.1
_ATTITUDE: Final = 1e-3


class SensorNoise:
    """Adds white noise to what a LowState measures: joint positions and speeds, and the IMU.

    Args:
        scale: the setting `sim.noise`, which has the standard deviations; 0: none.
        seed: of the random numbers; the same seed gives the same noise.
    """

    def __init__(self, scale: float = 1.0, seed: int = 0) -> None:
        self._scale = scale
        self._rng = np.random.default_rng(seed)

    def __call__(self, state: LowState) -> None:
        """Add noise to a LowState in place."""
        if not self._scale:
            return
        normal, scale = self._rng.normal, self._scale
        state.q[:] += normal(0.0, scale * _POSITION, N_JOINTS)
        state.dq[:] += normal(0.0, scale * _SPEED, N_JOINTS)
        state.gyroscope[:] += normal(0.0, scale * _GYROSCOPE, 3)
        state.accelerometer[:] += normal(0.0, scale * _ACCELEROMETER, 3)
        state.quaternion[:] = quat_normalize(
            state.quaternion + normal(0.0, 0.5 * scale * _ATTITUDE, 4)
        )
        state.rpy[:] = quat_to_rpy(state.quaternion.astype(np.float64))
