"""What the loop reads of a LowState; pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.robot.rotations import UNIT_TOLERANCE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.dds.messages import LowState

__all__ = ["STALE", "ImuReading", "Reading", "all_finite", "is_unit", "ticks_between"]

STALE: Final = 0.02
"""No torque is computed from a LowState older than this, s: ten states at 500 Hz, in which a fast
joint moves by 0.5 rad."""


class ImuReading(NamedTuple):
    """A reading of the IMU in the pelvis.

    Attributes:
        quat_wxyz: (4,) pelvis to world.
        gyroscope: (3,) rad/s, pelvis frame.
        accelerometer: (3,) m/s², pelvis frame, gravity included: upward 9.81 at rest.
    """

    quat_wxyz: NDArray[np.floating]
    gyroscope: NDArray[np.floating]
    accelerometer: NDArray[np.floating]


@dataclass(frozen=True)
class Reading:
    """A LowState as far as the loop uses it; a copy.

    Attributes:
        q, dq, tau: (29,) rad, rad/s, N·m, motor order.
        imu: in the pelvis.
        mode_machine: robot type.
        received: time of reception, ns of the loop's monotonic clock.
        tick: ms of the robot's time; 0 from Unitree's Python simulator.
        stamps: when it was published and when it was received, ns since the epoch; 0 where that is
            not known.
        content: the numbers above as bytes.
        finite: none of them is NaN or infinite.

    Torques are computed of `q`, `dq`, `tau` and `imu`; the checks need the others, but `stamps`,
    which are for records.
    """

    q: NDArray[np.floating]
    dq: NDArray[np.floating]
    tau: NDArray[np.floating]
    imu: ImuReading
    mode_machine: int = 0
    received: int = 0
    tick: int = 0
    content: bytes = b""
    finite: bool = True
    stamps: tuple[int, int] = (0, 0)

    @classmethod
    def from_low_state(cls, state: LowState, received: int) -> Reading:
        """Copy a LowState that was received at `received`, ns."""
        values = state.readings()
        return cls(
            values[:29],
            values[29:58],
            values[58:87],
            ImuReading(values[87:91], values[91:94], values[94:97]),
            int(state.mode_machine),
            received,
            int(state.tick),
            values.tobytes(),
            bool(np.isfinite(values).all()),
            (state.published, state.received),
        )


def ticks_between(before: int, after: int) -> int:
    """Ms from one tick of LowState to another, which counts in 32 bits; negative: it went back."""
    return (after - before + 2**31) % 2**32 - 2**31


def all_finite(values: NDArray[np.floating]) -> bool:
    """Whether no number of a short array is NaN or infinite: either one makes the sum so."""
    return math.isfinite(sum(values.tolist()))


def is_unit(quat_wxyz: NDArray[np.floating]) -> bool:
    """Whether a measured quaternion (4,) has a norm close to 1; False if it contains NaN."""
    return abs(math.hypot(*quat_wxyz.tolist()) - 1.0) <= UNIT_TOLERANCE
