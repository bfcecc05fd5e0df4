"""Motions from sessions and bags, for playing them again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from g1stream.errors import MotionError, RecordingError
from g1stream.files import is_session
from g1stream.motion.readers import Evidence, MotionFile, MotionReader
from g1stream.optional import extension
from g1stream.session.mcap_reader import McapFile
from g1stream.session.parts import parts_of
from g1stream.session.recorded_motion import FOXGLOVE, RecordedMotion, motion_of_poses
from g1stream.session.recording import open_recording
from g1stream.session.records import MotionInfo, read_record
from g1stream.session.streams import STREAMS, ReferenceStream
from g1stream.types import Phase

if TYPE_CHECKING:
    from g1stream.motion.motion import Motion
    from g1stream.session.recording import Recording

__all__ = ["attached_motion", "motion_of", "open_played", "recorded_motion"]


def open_played(file: MotionFile) -> MotionReader:
    """Open a session, or joint states recorded by another program or by `convert`.

    Raises:
        ConfigError: the extra that reads it is not installed.
        RecordingError: it is damaged.
    """
    return recorded_motion(file) or _PlayedMotion(file)


class _PlayedMotion(NamedTuple):
    """The motion of a session."""

    file: MotionFile
    evidence: Evidence = Evidence({"file": "a session; its motion is the recorded reference"})

    def motion(self) -> Motion:
        return motion_of(open_recording(self.file.path), self.file.fps)


def recorded_motion(file: MotionFile) -> RecordedMotion | None:
    """Open joint states recorded by another program or by `convert`; None for a session.

    Raises:
        ConfigError: the extra that reads it is not installed.
        RecordingError: it is damaged.
    """
    parts = parts_of(file.path)
    in_ros = not is_session(parts[0])  # SQLite, or compressed as a whole
    if not in_ros:
        files = [McapFile(part) for part in parts]
        types = {topic: kind for one in files for topic, kind in one.types.items()}
        in_ros = any(kind == "sensor_msgs/msg/JointState" for kind, _ in types.values())
        # A robot's own topics in a bag with joint states are not a session.
        has_joints = in_ros or not FOXGLOVE.joint_states.keys().isdisjoint(types.values())
        ours = ReferenceStream.topic in types or any(one.metadata for one in files)
        if not types.keys().isdisjoint(STREAMS) and (ours or not has_joints):
            return None
        if not in_ros:
            return RecordedMotion(file, files, FOXGLOVE)
    recorded: RecordedMotion = extension("read_bag")(file)
    return recorded


def motion_of(session: Recording, fps: float | None = None) -> Motion:
    """The played motion from the reference, or the motion from which `convert` made the file.

    Args:
        session: a recording.
        fps: frame rate of the result; the rate of the reference if None.

    Raises:
        RecordingError: there is no motion in this session.
        MotionError: `fps` is not a frame rate, or leaves fewer than two frames.
    """
    if session.converted and (recorded := recorded_motion(MotionFile(session.path, fps))):
        return recorded.motion()
    columns = "phase", "motion_time", "q", "root_pos", "root_quat_wxyz"
    reference, path = session.reference, session.path
    play = reference[reference.read(*columns).phase == Phase.PLAY].read(*columns)
    if len(play) < 2:
        raise RecordingError(
            f"No motion was played in {path}.",
            "Give a session in which `g1stream stream` reached the phase PLAY.",
        )
    return motion_of_poses(play.motion_time, play.q, play.root_pos, play.root_quat_wxyz, path, fps)


def attached_motion(session: Recording) -> Motion | None:
    """The motion in the attached file, if it is the one that was played.

    It is None if no file is attached, or if the played motion differs from the file's.
    """
    info, _ = read_record(MotionInfo, session.metadata.get("motion"))
    if info is None or info.source is None or info.content_sha256 is None:
        return None
    path = Path(info.source)
    member = None if info.name == path.stem else info.name  # its name in a file of several
    try:
        data = session.attachments[path.name]
        motion = MotionFile(path, info.fps, member=member, data=data).open().motion()
    except (KeyError, MotionError):
        return None
    return motion if motion.content_sha256 == info.content_sha256 else None
