"""Pose of the measured pelvis, from the IMU and a source of its position."""

from __future__ import annotations

from typing import Literal

import numpy as np

from g1stream.robot.rotations import (
    is_unit,
    quat_from_yaw,
    quat_mul,
    quat_normalize,
    quat_rotate,
    wrap_angle,
    yaw_of,
)
from g1stream.session.records import MeasuredTf
from g1stream.types import Floats, Ints

__all__ = ["MeasuredBase", "PositionSource"]

PositionSource = Literal["sportmodestate", "reference", "none"]


class MeasuredBase:
    """Computes the pose of the measured pelvis in the world of the reference.

    An IMU measures yaw relative to its attitude at power-on. Therefore the measured yaw is aligned
    with the yaw of the reference once, at the first state with a valid attitude after the first
    reference.

    The position is that of SportModeState, rotated by the same yaw about its value at that time.
    Without SportModeState it is the position of the reference, or the origin without a reference.

    An invalid attitude, such as zeros from an IMU that is not ready, is replaced by the last valid
    one. Before that, it is the attitude of the reference, or upright without a reference.

    Attributes:
        yaw_offset: offset that is added to the measured yaw, rad; None before it is known.
        source: source of the position.
    """

    def __init__(self) -> None:
        self.yaw_offset: float | None = None
        self.source: PositionSource = "none"
        self._start: Floats | None = None
        self._reference_yaw: float | None = None
        self._times: Ints = np.zeros(1, dtype=np.int64)
        self._positions: Floats = np.zeros((1, 3))
        self._measured = False
        # The attitude of the newest valid state, and that of the last one before the newest batch.
        self._attitude = self._before = np.array([1.0, 0.0, 0.0, 0.0])

    def add_references(self, times: Ints, positions: Floats, quats_wxyz: Floats) -> None:
        """Add references: times (T,) ns, positions (T, 3) m in the world, quaternions (T, 4)."""
        if self._reference_yaw is None:
            self._reference_yaw = float(yaw_of(quats_wxyz[0]))
        if not self._measured:
            self._attitude = quats_wxyz[-1]
        if self.source != "sportmodestate":
            self.source = "reference"
            self._extend(times, positions)

    def add_positions(self, times: Ints, positions: Floats) -> None:
        """Add positions of the pelvis: times (T,) ns, positions (T, 3) m in the world."""
        if self.source != "sportmodestate":
            self.source = "sportmodestate"
            self._times, self._positions = times, positions
        else:
            self._extend(times, positions)

    def add_states(self, times: Ints, imu_quats_wxyz: Floats) -> None:
        """Add states: times (T,) ns, quaternions (T, 4); the first valid one aligns the yaw."""
        valid = np.flatnonzero(is_unit(imu_quats_wxyz))
        self._before = self._attitude
        if not len(valid):
            return
        if self.yaw_offset is None and self._reference_yaw is not None:
            turn = self._reference_yaw - float(yaw_of(imu_quats_wxyz[valid[0]]))
            self.yaw_offset = float(wrap_angle(np.asarray(turn)))
            self._start = self._positions_at(times[valid[:1]])[0]
        self._measured = True
        self._attitude = quat_normalize(quat_mul(self._turn, imu_quats_wxyz[valid[-1]]))

    def poses(self, times: Ints, imu_quats_wxyz: Floats) -> tuple[Floats, Floats]:
        """Positions (T, 3) m and attitudes (T, 4) wxyz of the pelvis in the world.

        They are those of the last added states, by publish times (T,) ns and quaternions (T, 4).
        """
        positions = self._positions_at(times)
        if self.source == "sportmodestate" and self._start is not None:
            positions = self._start + quat_rotate(self._turn, positions - self._start)
        valid = is_unit(imu_quats_wxyz)
        last = np.maximum.accumulate(np.where(valid, np.arange(len(times)), -1))
        turned = quat_mul(self._turn, imu_quats_wxyz[last])
        attitudes = np.where((last < 0)[:, np.newaxis], self._before, turned)
        return positions, quat_normalize(attitudes)

    def summary(self) -> MeasuredTf:
        """The alignment, as a record."""
        return MeasuredTf(yaw_offset_rad=self.yaw_offset, position_from=self.source)

    @property
    def _turn(self) -> Floats:
        return quat_from_yaw(self.yaw_offset or 0.0)

    def _positions_at(self, times: Ints) -> Floats:
        """(T, 3) positions, linearly interpolated."""
        return np.stack([np.interp(times, self._times, axis) for axis in self._positions.T], axis=1)

    def _extend(self, times: Ints, positions: Floats) -> None:
        """Replace the known positions except the last one."""
        self._times = np.append(self._times[-1:], times)
        self._positions = np.concatenate([self._positions[-1:], positions])
