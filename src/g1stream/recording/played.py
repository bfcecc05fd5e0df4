"""What a session played, as a motion that can be played again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.errors import RecordingError
from g1stream.motion.motion import Motion, check_fps
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.recording.streams import Reference

__all__ = ["played_motion"]

_PLAY = 2
"""The phase, as Reference has it."""


def played_motion(reference: Reference, path: Path, fps: float | None = None) -> Motion:
    """The reference while it was played, at even times.

    Joints and position are cubic splines through the samples, the orientation turns evenly from one
    to the next; where the samples are evenly spaced and `fps` is their rate, the frames are the
    samples themselves.

    Args:
        reference: of the session.
        path: the session file, whose name the motion gets.
        fps: frames a second; the rate of the reference if None.

    Raises:
        RecordingError: nothing was played.
        MotionError: `fps` is not a frame rate, or leaves less than two frames.
    """
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, Slerp

    # Where a state was reported, motion time may stand still or, in somebody's file, go back.
    times, first = np.unique(reference.motion_time, return_index=True)
    playing = reference.phase[first] == _PLAY
    times, first = times[playing], first[playing]
    if len(times) < 2:
        raise RecordingError(
            f"{path} has no reference that was played.",
            "Give a session in which `g1stream stream` came to play its motion.",
        )
    rate = round(1.0 / float(np.median(np.diff(times))), 6) if fps is None else fps
    check_fps(rate, path.stem)
    n_frames = int((times[-1] - times[0]) * rate + 1e-6) + 1
    grid = np.minimum(times[0] + np.arange(n_frames) / rate, times[-1])
    linear = np.hstack([reference.q[first], reference.root_pos[first]])
    sampled = CubicSpline(times, linear)(grid)
    rotations = Rotation.from_quat(xyzw_from_wxyz(reference.root_quat_wxyz[first]))
    return Motion(
        name=path.stem,
        fps=rate,
        joint_names=JOINT_NAMES,
        joint_pos=sampled[:, : len(JOINT_NAMES)],
        root_pos=sampled[:, len(JOINT_NAMES) :],
        root_quat_wxyz=wxyz_from_xyzw(Slerp(times, rotations)(grid).as_quat()),
        source=path,
    )
