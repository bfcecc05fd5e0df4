"""Readings: the values of a LowState that the loop uses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.robot.rotations import UNIT_TOLERANCE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.dds.messages import LowState

__all__ = ["STALE", "ImuReading", "Reading", "all_finite", "is_unit", "ticks_between"]

STALE: Final = 0.02
"""Maximum age of a LowState from which a torque is computed, s: ten states at 500 Hz, in which a
fast joint moves by 0.5 rad."""

#: Velocities and gyroscope in the values of a LowState, and how many LowStates are compared.
_DQ, _RATE, _COMPARED = slice(29, 58), slice(91, 94), 3


class ImuReading(NamedTuple):
    """A reading of the IMU in the pelvis.

    Attributes:
        quat_wxyz: (4,) pelvis to world.
        gyroscope: (3,) rad/s, pelvis frame.
        accelerometer: (3,) m/s², pelvis frame, including gravity (9.81 upward at rest).
    """

    quat_wxyz: NDArray[np.floating]
    gyroscope: NDArray[np.floating]
    accelerometer: NDArray[np.floating]


@dataclass(frozen=True)
class Reading:
    """A copy of the values of a LowState that the loop uses.

    Attributes:
        q, dq, tau: (29,) rad, rad/s, N·m, motor order.
        imu: reading of the IMU in the pelvis.
        mode_machine: robot type.
        arrived: time of reception, ns of the loop's monotonic clock.
        tick: the robot's time, ms; 0 from Unitree's Python simulator.
        content: `q`, `dq`, `tau` and `imu` as bytes.
        finite: whether `q`, `dq`, `tau` and `imu` have no NaN or infinity.
        stamps: publish time and reception time, ns since the epoch, for records; 0 if unknown.
        recent: the values of up to three LowStates, with different content and finite, oldest
            first, each after its time of reception, ns.
    """

    q: NDArray[np.floating]
    dq: NDArray[np.floating]
    tau: NDArray[np.floating]
    imu: ImuReading
    mode_machine: int = 0
    arrived: int = 0
    tick: int = 0
    content: bytes = b""
    finite: bool = True
    stamps: tuple[int, int] = (0, 0)
    recent: tuple[tuple[int, NDArray[np.floating]], ...] = ()

    @property
    def steady_dq(self) -> NDArray[np.floating]:
        """(29,) rad/s, without a value that only one LowState has: the median of the last three.

        `dq` until there are three that are not older than `STALE`.
        """
        return self.dq if self._steady is None else self._steady[_DQ]

    @property
    def steady_rate(self) -> NDArray[np.floating]:
        """(3,) rad/s, the gyroscope, as `steady_dq`."""
        return self.imu.gyroscope if self._steady is None else self._steady[_RATE]

    @cached_property
    def _steady(self) -> NDArray[np.floating] | None:
        """The median of all values; None if they cannot be compared."""
        recent = self.recent
        if len(recent) < _COMPARED or self.arrived - recent[0][0] > STALE * 1e9:
            return None
        (_, first), (_, second), (_, third) = recent
        low, high = np.minimum(first, second), np.maximum(first, second)
        steady: NDArray[np.floating] = np.maximum(low, np.minimum(high, third))
        return steady

    @classmethod
    def from_low_state(
        cls, state: LowState, arrived: int, before: Reading | None = None
    ) -> Reading:
        """Copy a LowState that was received at `arrived`, ns of the monotonic clock.

        `before` is the one before it from the same publisher.
        """
        values = state.readings()
        content, recent = values.tobytes(), before.recent if before else ()
        finite = bool(np.isfinite(values).all())
        if before is None or content != before.content:
            recent = (*recent[1 - _COMPARED :], (arrived, values)) if finite else ()
        return cls(
            values[:29],
            values[29:58],
            values[58:87],
            ImuReading(values[87:91], values[91:94], values[94:97]),
            int(state.mode_machine),
            arrived,
            int(state.tick),
            content,
            finite,
            (state.published, state.received),
            recent,
        )


def ticks_between(before: int, after: int) -> int:
    """Difference of two 32-bit ticks of LowState, ms; negative if the tick went back."""
    return (after - before + 2**31) % 2**32 - 2**31


def all_finite(values: NDArray[np.floating]) -> bool:
    """Whether a short array has no NaN or infinity; either one propagates to the sum."""
    return math.isfinite(sum(values.tolist()))


def is_unit(quat_wxyz: NDArray[np.floating]) -> bool:
    """Whether a measured quaternion (4,) has a norm close to 1; False if it contains NaN.

    That of `robot.rotations` for one quaternion, and faster.
    """
    return abs(math.hypot(*quat_wxyz.tolist()) - 1.0) <= UNIT_TOLERANCE
