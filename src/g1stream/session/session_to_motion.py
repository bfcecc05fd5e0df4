"""What a session played, as a motion that can be played again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.errors import RecordingError
from g1stream.motion.motion import Motion, check_fps
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.session.streams import Reference


__all__ = ["commanded_motion", "even_motion", "played_motion"]


def played_motion(reference: Reference, path: Path, fps: float | None = None) -> Motion:
    """The reference while it was played, as a motion of its own.

    Args:
        reference: of the session.
        path: the session file, whose name the motion gets.
        fps: frames a second; the rate of the reference if None.

    Raises:
        RecordingError: nothing was played.
        MotionError: `fps` is not a frame rate, or leaves less than two frames.
    """
    playing = reference.phase == Phase.PLAY
    if playing.sum() < 2:
        raise RecordingError(
            f"{path} has no reference that was played.",
            "Give a session in which `g1stream stream` came to play its motion.",
        )
    return even_motion(
        reference.motion_time[playing],
        reference.q[playing],
        reference.root_pos[playing],
        reference.root_quat_wxyz[playing],
        path,
        fps,
    )


def commanded_motion(times: Floats, q: Floats, path: Path) -> Motion:
    """What was commanded, where there is no reference: the pelvis rests upright at the origin.

    Args:
        times: (N,) s, rising.
        q: (N, 29) rad, motor order.
        path: the session file, whose name the motion gets.

    Raises:
        MotionError: that is less than two frames.
    """
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(q), 1))
    return even_motion(times, q, np.zeros((len(q), 3)), upright, path, None)


def even_motion(
    times: Floats,
    q: Floats,
    root_pos: Floats,
    root_quat_wxyz: Floats,
    path: Path,
    fps: float | None,
) -> Motion:
    """A motion at even times from poses at N times.

    Joints and position are cubic splines through the poses, the orientation turns evenly from one
    to the next. Where the times are even and `fps` is their rate, the frames are the poses.

    Args:
        times: (N,) s; where one comes again, its first pose is taken.
        q: (N, 29) rad, motor order.
        root_pos: (N, 3) m, world.
        root_quat_wxyz: (N, 4) pelvis to world.
        path: where they come from; the motion gets its name.
        fps: frames a second; the usual rate of the times if None.

    Raises:
        MotionError: `fps` is not a frame rate, or leaves less than two frames.
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
        joint_pos=sampled[:, : len(JOINT_NAMES)],
        root_pos=sampled[:, len(JOINT_NAMES) :],
        root_quat_wxyz=wxyz_from_xyzw(Slerp(times, rotations)(grid).as_quat()),
        source=path,
    )
