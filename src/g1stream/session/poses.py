"""A motion of constant frame rate from recorded poses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import RecordingError
from g1stream.input_limits import FRAMES, NUMBER
from g1stream.motion.motion import SMALLEST_QUAT, Motion, check_fps
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.text import counted
from g1stream.types import Floats

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["motion_of_poses"]

#: Times that differ by less are the same, s.
_SAME_TIME: Final = 1e-6


def motion_of_poses(
    times: Floats,
    q: Floats,
    root_pos: Floats,
    root_quat_wxyz: Floats,
    path: Path,
    fps: float | None,
) -> Motion:
    """A motion of constant frame rate from N poses.

    Of poses within the same microsecond the first is taken. Where the times have the rate `fps`,
    the frames are the poses; elsewhere they are between them, on cubic splines.

    Args:
        times: (N,) s, rising.
        q: (N, 29) rad, motor order.
        root_pos: (N, 3) m, the pelvis in the world frame.
        root_quat_wxyz: (N, 4) likewise, not zero.
        path: of the recording; the motion gets its name.
        fps: frames per second; the usual rate of the poses if None.

    Raises:
        RecordingError: a value is not finite or too large, or the times are not those of a motion.
        MotionError: `fps` is not a frame rate.
    """
    numbers = np.column_stack([times, q, root_pos, root_quat_wxyz])
    norms = np.abs(root_quat_wxyz).max(axis=1)
    valid = (np.abs(numbers) <= NUMBER).all(axis=1) & (norms > SMALLEST_QUAT)
    if not valid.all():
        raise RecordingError(
            f"The motion of {path} has {counted(int((~valid).sum()), 'sample')} with a value that "
            f"no motion has, the first at {np.argmin(valid)}: one that is not finite or beyond "
            f"{NUMBER:g}, or a zero quaternion.",
            "Record the motion again.",
        )
    _, first = np.unique(times.round(6), return_index=True)
    times = times[first]
    if len(times) < 2:
        raise RecordingError(
            f"The motion of {path} stands still at {times[0]:g} s.", "Record the motion again."
        )
    rate = round(1.0 / float(np.median(np.diff(times))), 3) if fps is None else fps
    check_fps(rate, path.stem)
    n_frames = int((times[-1] - times[0]) * rate + 1e-6) + 1
    if n_frames > max(FRAMES, 10 * len(times)):
        raise RecordingError(
            f"The motion of {path} takes {times[-1] - times[0]:g} s, but has {len(times)} samples.",
            "Record the motion again.",
        )
    grid = np.minimum(times[0] + np.arange(n_frames) / rate, times[-1])
    q, root_pos, root_quat_wxyz = q[first], root_pos[first], root_quat_wxyz[first]
    if len(grid) != len(times) or np.abs(grid - times).max() > _SAME_TIME:
        q, root_pos, root_quat_wxyz = _interpolated(times, q, root_pos, root_quat_wxyz, grid)
    return Motion(
        name=path.stem,
        fps=rate,
        joint_pos=q,
        root_pos=root_pos,
        root_quat_wxyz=root_quat_wxyz,
        source=path,
    )


def _interpolated(
    times: Floats, q: Floats, root_pos: Floats, root_quat_wxyz: Floats, grid: Floats
) -> tuple[Floats, Floats, Floats]:
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, Slerp

    sampled = CubicSpline(times, np.hstack([q, root_pos]))(grid)
    rotations = Slerp(times, Rotation.from_quat(xyzw_from_wxyz(root_quat_wxyz)))(grid)
    quat = wxyz_from_xyzw(rotations.as_quat())
    return sampled[:, :N_JOINTS], sampled[:, N_JOINTS:], quat
