"""Motions from motion files, from bags, and from sessions, to play again what was played."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.errors import MotionError, RecordingError
from g1stream.files import begins_with, is_session
from g1stream.motion.files import motion_file, open_motion_file
from g1stream.motion.motion import Motion, check_fps
from g1stream.optional import extension
from g1stream.session.recorded_motion import FOXGLOVE, RecordedMotion, motion_of_poses
from g1stream.session.records import MotionInfo, read_record
from g1stream.types import STREAM_RATE, Phase

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    from g1stream.motion.check import FileReport
    from g1stream.robot.model import G1
    from g1stream.session.recording import Recording
    from g1stream.session.streams import Reference
    from g1stream.types import JointOrder

__all__ = [
    "attached_motion",
    "check_motion_file",
    "load_motion",
    "motion_of",
    "recorded_motion",
]

_READERS: Final[dict[bytes | str, str]] = {
    b"SQLite format 3\0": "read_bag",
    b"\x28\xb5\x2f\xfd": "read_bag",  # a file of a bag, compressed as a whole
    "sensor_msgs/msg/JointState": "read_bag",
}
"""What reads recordings of others, by how a file begins or by a type of the messages in an MCAP."""


def load_motion(
    path_or_name: str | os.PathLike[str],
    *,
    fps: float | None = None,
    joint_order: JointOrder | None = None,
) -> Motion:
    """Read a motion file, a session, a bag, or a bundled motion by its name (`demo`).

    Args:
        path_or_name: a file of one of the formats in docs/formats.md, followed by `:NAME` for a
            motion in a file of several; a session file, whose motion
            is the reference that was played; a bag with joint states; or the name of a bundled
            motion.
        fps: frames per second; what the file says if None, or 30 where it does not, as a CSV file
            cannot. A session is sampled at it, at the rate of its reference if None.
        joint_order: of the joints where a file does not name them. If None, a CSV file without a
            header is taken to be in motor order, and for arrays joint limits and bodies decide.

    Returns:
        The motion, its joints in motor order whatever the order in the file, its quaternions unit.
        Those that were off by more than 1e-3 give a warning in `Motion.warnings`.

    Raises:
        MotionError: there is no such file, or something in it is wrong; names line and column.
        RecordingError: the session is damaged, or no motion was played in it.
    """
    path = Path(path_or_name)
    if recorded := recorded_motion(path):
        return recorded.motion(fps)
    if is_session(path):
        from g1stream.session.recording import open_recording

        return motion_of(open_recording(path), fps)
    file = open_motion_file(path_or_name, joint_order)
    if fps is not None:
        check_fps(fps, file.path.stem)
    return file.motion(fps)


def recorded_motion(path: Path) -> RecordedMotion | None:
    """The recording of others, or of `convert`, at a path; None for a session or a motion file.

    Raises:
        ConfigError: the extra that reads it is not installed.
        RecordingError: it is damaged.
    """
    starts = [start for start in _READERS if isinstance(start, bytes)]
    if not is_session(path) and not any(begins_with(path, start) for start in starts):
        return None
    from g1stream.session.mcap_reader import McapFile
    from g1stream.session.parts import parts_of
    from g1stream.session.streams import STREAMS, Reference

    parts = parts_of(path)
    readers = [_READERS[start] for start in starts if begins_with(parts[0], start)]
    if not readers:
        files = [McapFile(part) for part in parts]
        types = {topic: kind for file in files for topic, kind in file.types.items()}
        readers = [_READERS[kind] for kind, _ in types.values() if kind in _READERS]
        # A robot's own topics in a bag with joint states are none of ours.
        has_joints = readers or not FOXGLOVE.joint_states.keys().isdisjoint(types.values())
        ours = Reference.topic in types or any(file.metadata for file in files)
        if not types.keys().isdisjoint(STREAMS) and (ours or not has_joints):
            return None
        if not readers:
            return RecordedMotion(path, files, FOXGLOVE)
    recorded: RecordedMotion = extension(readers[0])(path)
    return recorded


def check_motion_file(
    path_or_name: str | os.PathLike[str],
    robot: G1,
    *,
    fps: float | None = None,
    joint_order: JointOrder | None = None,
    change: Callable[[Motion], Motion] = lambda motion: motion,
    rate: float = STREAM_RATE,
    position_margin: float = 0.0,
) -> FileReport:
    """Check what `load_motion` reads, without raising for a fault in it.

    Args:
        path_or_name: as for `load_motion`.
        robot: whose limits.
        fps: as for `load_motion`.
        joint_order: as for `load_motion`.
        change: what it makes of the motion is checked.
        rate: joint targets per second when it is streamed, Hz.
        position_margin: rad, kept from position limits when it is streamed.

    Raises:
        MotionError: there is no such file, it is empty or not text; or `fps` is not a frame rate.
        RecordingError: the session is damaged, or no motion was played in it.
    """
    from g1stream.motion.check import FileReport, check_file, check_motion

    path = Path(path_or_name)
    if recorded := recorded_motion(path):
        motion = check_motion(
            change(recorded.motion(fps)), robot, rate=rate, position_margin=position_margin
        )
        return FileReport(path, kind="bag", evidence=recorded.evidence, motion=motion)
    if not is_session(path):
        return check_file(
            path_or_name,
            robot,
            fps=fps,
            joint_order=joint_order,
            change=change,
            rate=rate,
            position_margin=position_margin,
        )
    motion = check_motion(
        change(load_motion(path, fps=fps)), robot, rate=rate, position_margin=position_margin
    )
    return FileReport(path, kind="session", motion=motion)


def motion_of(session: Recording, fps: float | None = None) -> Motion:
    """The motion that was played, as the reference has it; or what `convert` made of a motion.

    Args:
        session: a recording.
        fps: frames per second; the rate of the reference if None.

    Raises:
        RecordingError: there is no motion in this session.
        MotionError: `fps` is not a frame rate, or leaves less than two frames.
    """
    if session.converted and (recorded := recorded_motion(session.path)):
        return recorded.motion(fps)
    return _reference_motion(session.reference, session.path, fps)


def _reference_motion(reference: Reference, path: Path, fps: float | None = None) -> Motion:
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
    return motion_of_poses(play.motion_time, play.q, play.root_pos, play.root_quat_wxyz, path, fps)


def attached_motion(session: Recording) -> Motion | None:
    """The whole motion in the attached file, where that is the one which was played.

    None where no file is attached, or what was played is something else that was made of it.
    """
    info, _ = read_record(MotionInfo, session.metadata.get("motion"))
    if info is None or info.source is None or info.content_sha256 is None:
        return None
    path = Path(info.source)
    member = None if info.name == path.stem else info.name  # of a file of several
    try:
        file = motion_file(path, session.attachments[path.name], member=member)
        motion = file.motion(info.fps)
    except (KeyError, MotionError):
        return None
    return motion if motion.content_sha256 == info.content_sha256 else None
