"""What is measured of the robot, and simple judgements of it; pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["ImuReading", "Measured", "all_finite", "is_unit", "tilt_of"]

#: By how much the length of an IMU's quaternion may be off.
_LENGTH_TOLERANCE: Final = 0.05


@dataclass
class Measured:
    """What the latest LowState says.

    Attributes:
        q, dq: (29,) rad, rad/s, motor order.
        quat_wxyz: (4,) pelvis to world.
        mode_machine: which robot it is.
        received: when it came, ns of the loop's monotonic clock.
    """

    q: NDArray[np.float32]
    dq: NDArray[np.float32]
    quat_wxyz: NDArray[np.float32]
    mode_machine: int
    received: int


def tilt_of(quat_wxyz: NDArray[np.floating]) -> float:
    """The angle between the body's z axis and the world's, rad, of a unit quaternion (4,) wxyz.

    The world's z component of the rotated z axis is 1 - 2 (x^2 + y^2).
    """
    x, y = float(quat_wxyz[1]), float(quat_wxyz[2])
    return math.acos(min(1.0, max(-1.0, 1.0 - 2.0 * (x * x + y * y))))


class ImuReading(NamedTuple):
    """What the pelvis's inertial unit says.

    Attributes:
        quat_wxyz: (4,) pelvis to world.
        gyroscope: (3,) rad/s, pelvis frame.
        accelerometer: (3,) m/s², pelvis frame, gravity included: upward 9.81 at rest.
    """

    quat_wxyz: NDArray[np.floating]
    gyroscope: NDArray[np.floating]
    accelerometer: NDArray[np.floating]


def all_finite(values: NDArray[np.floating]) -> bool:
    """Whether none of a few numbers is NaN or infinite: neither disappears from a sum."""
    return math.isfinite(sum(values.tolist()))


def is_unit(quat_wxyz: NDArray[np.floating]) -> bool:
    """Whether a measured quaternion (4,) is a rotation, or nearly; one with NaN is not."""
    return abs(math.hypot(*quat_wxyz.tolist()) - 1.0) < _LENGTH_TOLERANCE
