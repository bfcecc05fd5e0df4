"""The motion of a session, so that it can be played again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.errors import RecordingError
from g1stream.motion.motion import Motion, check_fps
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.session.streams import Reference


__all__ = ["commanded_motion", "reference_motion"]


def reference_motion(reference: Reference, path: Path, fps: float | None = None) -> Motion:
    """The reference in PLAY as a motion.

    Args:
        reference: of the session.
        path: of the session; the motion gets its name.
        fps: frames per second; the rate of the reference if None.

    Raises:
        RecordingError: nothing was played.
        MotionError: `fps` is not a frame rate, or leaves less than two frames.
    """
    columns = "phase", "motion_time", "q", "root_pos", "root_quat_wxyz"
    play = reference[reference.read(*columns).phase == Phase.PLAY].read(*columns)
    if len(play) < 2:
        raise RecordingError(
            f"No motion was played in {path}.",
            "Give a session in which `g1stream stream` reached the phase PLAY.",
        )
    return _resampled(play.motion_time, play.q, play.root_pos, play.root_quat_wxyz, path, fps)


def commanded_motion(times: Floats, q: Floats, path: Path) -> Motion:
    """The joint targets of the commands, where there is no reference; the pelvis stays upright.

    Args:
        times: (N,) s, rising.
        q: (N, 29) rad, motor order.
        path: of the session; the motion gets its name.

    Raises:
        MotionError: that is less than two frames.
    """
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(q), 1))
    return _resampled(times, q, np.zeros((len(q), 3)), upright, path, None)


def _resampled(
    times: Floats,
    q: Floats,
    root_pos: Floats,
    root_quat_wxyz: Floats,
    path: Path,
    fps: float | None,
) -> Motion:
    """A motion of constant frame rate from N poses, at their usual rate if `fps` is None.

    Joints and position are cubic splines through the poses, the orientation is interpolated
    linearly (slerp). Where the times have the rate `fps`, the frames are the poses. Of poses of the
    same time the first is taken.
    """
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, Slerp

    times, first = np.unique(times, return_index=True)
    rate = round(1.0 / float(np.median(np.diff(times))), 3) if fps is None else fps
    check_fps(rate, path.stem)
    n_frames = int((times[-1] - times[0]) * rate + 1e-6) + 1
    grid = np.minimum(times[0] + np.arange(n_frames) / rate, times[-1])
    sampled = CubicSpline(times, np.hstack([q[first], root_pos[first]]))(grid)
    rotations = Rotation.from_quat(xyzw_from_wxyz(root_quat_wxyz[first]))
    return Motion(
        name=path.stem,
        fps=rate,
        joint_names=JOINT_NAMES,
        joint_pos=sampled[:, :N_JOINTS],
        root_pos=sampled[:, N_JOINTS:],
        root_quat_wxyz=wxyz_from_xyzw(Slerp(times, rotations)(grid).as_quat()),
        source=path,
    )
