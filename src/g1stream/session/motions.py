"""Motions from sessions and bags, for playing them again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.errors import RecordingError
from g1stream.files import is_session
from g1stream.input_limits import FRAMES, NUMBER
from g1stream.motion.motion import SMALLEST_QUAT, Motion, check_fps
from g1stream.motion.readers import ATTACH, Evidence, MotionFile, MotionReader
from g1stream.optional import extension
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.session.mcap_reader import McapFile
from g1stream.session.recording import open_recording
from g1stream.session.source import JOINT_STATES, files_of
from g1stream.session.streams import MAX_GAP_NS, STREAMS, ReferenceStream
from g1stream.text import counted
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.session.recording import Recording

__all__ = [
    "GAP_PERIODS",
    "PAUSE_NS",
    "motion_of",
    "motion_of_poses",
    "open_played",
]

#: Times that differ by less are equal, s.
_SAME_TIME: Final = 1e-6
#: Number of gaps that are listed.
_MOST_GAPS: Final = 5

GAP_PERIODS: Final = 5
"""An interval of more than this many periods and more than `MAX_GAP_NS` is a gap, which becomes a
straight line."""

PAUSE_NS: Final = 10_000_000_000
"""If a gap is longer than this, ns, the recording was interrupted or its clock was stepped."""


def open_played(file: MotionFile) -> MotionReader:
    """Open a session, or joint states recorded by another program or by `convert`.

    Raises:
        ConfigError: the extra that reads it is not installed.
        RecordingError: it is damaged.
    """
    if is_of_g1stream(file.path):
        return _PlayedMotion(file)
    reader: MotionReader = extension("read_recording")(file)
    return reader


def is_of_g1stream(path: Path) -> bool:
    """Whether a recording has samples of a robot or nothing, and is no bag of joint states.

    Raises:
        RecordingError: it is damaged.
    """
    parts = files_of(path)
    if not is_session(parts[0]):  # SQLite, or compressed as a whole
        return False
    files = [McapFile(part) for part in parts]
    types = {topic: kind for one in files for topic, kind in one.types.items()}
    ours = ReferenceStream.topic in types or any(one.metadata for one in files)
    has_joints = not JOINT_STATES.isdisjoint(types.values())
    return not types or (not types.keys().isdisjoint(STREAMS) and (ours or not has_joints))


class _PlayedMotion(NamedTuple):
    """The motion of a session."""

    file: MotionFile
    evidence: Evidence = Evidence({"file": "a session; its motion is the recorded reference"})

    def motion(self) -> Motion:
        return motion_of(open_recording(self.file.path), self.file.fps)


def motion_of(session: Recording, fps: float | None = None) -> Motion:
    """The motion of a recording; see `Session.motion`."""
    if session.converted:
        converted: MotionReader = extension("read_recording")(MotionFile(session.path, fps))
        return converted.motion()
    columns = "phase", "motion_time", "q", "root_pos", "root_quat_wxyz"
    path = session.path
    if not session.topics.get(ReferenceStream.topic):
        raise RecordingError(
            f"{path} has no {ReferenceStream.topic}: nothing was played, or by another program.",
            ATTACH,
        )
    reference = session.reference
    play = reference[reference.read(*columns).phase == Phase.PLAY].read(*columns)
    if len(play) < 2:
        raise RecordingError(
            f"No motion was played in {path}.",
            "Give a session in which `g1stream stream` reached the phase PLAY.",
        )
    return motion_of_poses(play.motion_time, play.q, play.root_pos, play.root_quat_wxyz, path, fps)


def motion_of_poses(
    times: Floats,
    q: Floats,
    root_pos: Floats,
    root_quat_wxyz: Floats,
    path: Path,
    fps: float | None,
) -> Motion:
    """Make a motion of constant frame rate from N poses.

    If several poses are within the same microsecond, the first one is used. If the times have the
    rate `fps`, the frames are the poses. Otherwise the frames are on cubic splines between the
    poses, and on straight lines in gaps, which the warnings list.

    Args:
        times: (N,) s, increasing.
        q: (N, 29) rad, motor order.
        root_pos: (N, 3) m, the pelvis in the world frame.
        root_quat_wxyz: (N, 4) orientation of the pelvis, not zero.
        path: path of the recording; the motion gets its name.
        fps: frame rate; the usual rate of the poses if None.

    Raises:
        RecordingError: a value is not finite or too large, or the times are not those of a motion:
            time does not advance, or there is a gap of more than 10 s.
        MotionError: `fps` is not a frame rate.
    """
    numbers = np.column_stack([times, q, root_pos, root_quat_wxyz])
    norms = np.abs(root_quat_wxyz).max(axis=1)
    valid = (np.abs(numbers) <= NUMBER).all(axis=1) & (norms > SMALLEST_QUAT)
    if not valid.all():
        raise RecordingError(
            f"The motion of {path} has {counted(int((~valid).sum()), 'sample')} with an invalid "
            f"value, the first at {np.argmin(valid)}: a number that is not finite or beyond "
            f"{NUMBER:g}, or a zero quaternion.",
            "Record the motion again.",
        )
    _, first = np.unique(times.round(6), return_index=True)
    times = times[first]
    if len(times) < 2:
        raise RecordingError(
            f"The times of {path} do not advance: all are {times[0]:g} s.",
            "Record the motion again.",
        )
    intervals = np.diff(times)
    period = float(np.median(intervals))
    rate = round(1.0 / period, 3) if fps is None else fps
    check_fps(rate, path.stem)
    n_frames = int((times[-1] - times[0]) * rate + 1e-6) + 1
    longest = int(intervals.argmax())
    paused = intervals[longest] > max(PAUSE_NS / 1e9, GAP_PERIODS * period)
    if paused or n_frames > max(FRAMES, 10 * len(times)):
        raise RecordingError(
            f"The motion of {path} lasts {times[-1] - times[0]:g} s, but has {len(times)} samples, "
            f"and none from {times[longest]:g} to {times[longest + 1]:g} s.",
            "Record the motion again.",
        )
    grid = np.minimum(times[0] + np.arange(n_frames) / rate, times[-1])
    q, root_pos, root_quat_wxyz = q[first], root_pos[first], root_quat_wxyz[first]
    gaps = np.flatnonzero(intervals > max(MAX_GAP_NS / 1e9, GAP_PERIODS * period))
    if len(grid) != len(times) or np.abs(grid - times).max() > _SAME_TIME:
        poses = q, root_pos, root_quat_wxyz
        q, root_pos, root_quat_wxyz = _interpolated(times, *poses, grid, gaps + 1)
    return Motion(
        name=path.stem,
        fps=rate,
        joint_pos=q,
        root_pos=root_pos,
        root_quat_wxyz=root_quat_wxyz,
        source=path,
        warnings=tuple(
            f"{path.name}: nothing was recorded for {intervals[i]:.2f} s from {times[i]:.2f} s on; "
            "the motion is a straight line there"
            for i in gaps[:_MOST_GAPS]
        ),
    )


def _interpolated(
    times: Floats,
    q: Floats,
    root_pos: Floats,
    root_quat_wxyz: Floats,
    grid: Floats,
    breaks: NDArray[np.intp],
) -> tuple[Floats, Floats, Floats]:
    """Values on a time grid: cubic splines, and straight lines before each of the breaks."""
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, Slerp

    values = np.hstack([q, root_pos])
    sampled = np.column_stack([np.interp(grid, times, column) for column in values.T])
    for part in np.split(np.arange(len(times)), breaks):
        first, last = np.searchsorted(grid, times[[part[0], part[-1]]])
        if len(part) > 1:
            inside = slice(first, last + 1)
            sampled[inside] = CubicSpline(times[part], values[part])(grid[inside])
    rotations = Slerp(times, Rotation.from_quat(xyzw_from_wxyz(root_quat_wxyz)))(grid)
    quat = wxyz_from_xyzw(rotations.as_quat())
    return sampled[:, :N_JOINTS], sampled[:, N_JOINTS:], quat
