"""PLAY at 50 frames per second: reference and measured robot at the same instants.

Body-space metrics of papers are those of frames at the rate of a policy, 50 Hz, and their
velocities are per frame; forward kinematics at every LowState would cost ten times as much and
change no mean.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.robot.rotations import (
    UNIT_TOLERANCE,
    quat_from_yaw,
    quat_mul,
    quat_normalize,
    quat_rotate,
    yaw_of,
)
from g1stream.types import Floats
from g1stream.view.tracking_error import MAX_GAP_NS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.analysis.tracking import Tracking
    from g1stream.session.session import Session

__all__ = ["FPS", "MEASURED_COLUMNS", "REFERENCE_COLUMNS", "Frames", "Robot", "frames"]

FPS: Final = 50.0

REFERENCE_COLUMNS: Final = (
    "q",
    "dq",
    "phase",
    "played",
    "motion_time",
    "root_pos",
    "root_quat_wxyz",
    "root_lin_vel",
    "root_ang_vel",
)
MEASURED_COLUMNS: Final = ("q", "dq", "imu_quat_wxyz", "gyroscope")
"""The columns of a session that `frames` reads."""


class Robot(NamedTuple):
    """A robot in F frames, in the world of the reference.

    Attributes:
        q, dq: (F, 29) rad and rad/s.
        root_pos, root_lin_vel: (F, 3) m and m/s, world.
        root_quat_wxyz: (F, 4) pelvis to world.
        root_ang_vel: (F, 3) rad/s, pelvis frame.
    """

    q: Floats
    dq: Floats
    root_pos: Floats
    root_lin_vel: Floats
    root_quat_wxyz: Floats
    root_ang_vel: Floats


class Frames(NamedTuple):
    """F frames of PLAY; where states or reference have a gap, there are none.

    Attributes:
        motion_time: (F,) s since the motion's first frame.
        consecutive: (F - 1,) whether a frame is followed by the next one.
        reference, measured: the two robots. The measured one is turned about the vertical and
            moved so that its pelvis is where the reference's is in frame 0: an IMU measures yaw
            from where it was switched on, and odometry has an origin of its own.
        has_attitude: whether an IMU measured the attitude; else it is the reference's.
        has_position: whether the position was measured, and the attitude; else it is the
            reference's.
    """

    motion_time: Floats
    consecutive: NDArray[np.bool_]
    reference: Robot
    measured: Robot
    has_attitude: bool
    has_position: bool


def frames(session: Session, tracking: Tracking) -> Frames | None:
    """The frames of a session; None where PLAY is too short for one.

    Raises:
        RecordingError: the file is damaged.
    """
    reference = session.reference.read(*REFERENCE_COLUMNS)
    measured = session.measured.read(*MEASURED_COLUMNS)
    states, asked = _Sampler(tracking.time), _Sampler(reference.time)
    numbers = np.arange(int((tracking.time[-1] - tracking.time[0]) * FPS + 1e-6) + 1)
    at = tracking.time[0] + numbers / FPS
    known = states.known(at) & asked.known(at)
    base = session.base
    if base is not None:
        base_times = _Sampler(base.time)
        finite = all(np.isfinite(one).all() for one in (base.position, base.velocity))
        base_known = base_times.known(at) & finite
        if (known & base_known).any():
            known &= base_known
        else:
            base = None
    numbers, at = numbers[known], at[known]
    if not len(at):
        return None
    target = Robot(
        q=states.at(at, tracking.reference),
        dq=asked.at(at, reference.dq),
        root_pos=asked.at(at, reference.root_pos),
        root_lin_vel=asked.at(at, reference.root_lin_vel),
        root_quat_wxyz=quat_normalize(asked.at(at, reference.root_quat_wxyz)),
        root_ang_vel=asked.at(at, reference.root_ang_vel),
    )
    robot = target._replace(
        q=states.at(at, tracking.measured), dq=states.at(at, measured.dq, tracking.states)
    )
    quat = states.at(at, measured.imu_quat_wxyz, tracking.states)
    # An IMU that is not there sends zeros.
    has_attitude = bool((np.abs(np.linalg.norm(quat, axis=1) - 1.0) <= UNIT_TOLERANCE).all())
    has_attitude &= bool(np.isfinite(measured.gyroscope).all())
    if has_attitude:
        quat = quat_normalize(quat)
        yaw = yaw_of(target.root_quat_wxyz[0]) - yaw_of(quat[0])
        turn = quat_from_yaw(yaw)
        robot = robot._replace(
            root_quat_wxyz=quat_mul(turn, quat),
            root_ang_vel=states.at(at, measured.gyroscope, tracking.states),
        )
        if base is not None:
            pos = base_times.at(at, base.position)
            robot = robot._replace(
                root_pos=target.root_pos[0] + quat_rotate(turn, pos - pos[0]),
                root_lin_vel=quat_rotate(turn, base_times.at(at, base.velocity)),
            )
    return Frames(
        motion_time=states.at(at, tracking.motion_time[:, np.newaxis])[:, 0],
        consecutive=np.diff(numbers) == 1,
        reference=target,
        measured=robot,
        has_attitude=has_attitude,
        has_position=has_attitude and base is not None,
    )


class _Sampler:
    """Interpolates samples at N times (N,), s, linearly."""

    def __init__(self, times: Floats) -> None:
        self._order = np.argsort(times, kind="stable")
        self._times = times[self._order]

    def _before(self, at: Floats) -> NDArray[np.intp]:
        after = np.searchsorted(self._times, at, side="right")
        return (after - 1).clip(0, max(0, len(self._times) - 2))

    def known(self, at: Floats) -> NDArray[np.bool_]:
        """(F,) whether samples are around the times (F,), and not far apart."""
        before = self._before(at)
        gaps = np.diff(self._times, append=np.inf)[before]
        inside = (at >= self._times[0]) & (at <= self._times[-1])
        return np.asarray(inside & (gaps <= MAX_GAP_NS / 1e9))

    def at(self, at: Floats, values: Floats, rows: NDArray[np.intp] | None = None) -> Floats:
        """(F, K) values (N, K), or some rows (N,) of values, at the times (F,)."""
        before = self._before(at)
        start, end = self._times[before], self._times[before + 1]
        weight = ((at - start) / np.maximum(end - start, 1e-9))[:, np.newaxis]
        order = self._order if rows is None else rows[self._order]
        earlier = values[order[before]]
        between: Floats = earlier + weight * (values[order[before + 1]] - earlier)
        return between
