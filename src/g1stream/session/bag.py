"""Bags of ROS 2 and MCAP files of others: a motion from their joint states and transforms.

Read are sensor_msgs/JointState with tf2_msgs/TFMessage, in CDR, and Foxglove's JointStates with
FrameTransforms, in protobuf, from MCAP and from SQLite, one file or a directory of parts.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from contextlib import closing
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar
from urllib.parse import quote

import numpy as np

from g1stream.dds.ros2 import FramePose, JointAngles, decode_joint_state, decode_tf
from g1stream.errors import MotionError, RecordingError
from g1stream.files import is_sqlite
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import quat_normalize, wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.session.mcap_reader import McapFile
from g1stream.session.parts import parts_of
from g1stream.session.poses import motion_of_poses
from g1stream.session.source import Messages
from g1stream.session.streams import STREAMS
from g1stream.text import counted
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from g1stream.motion.motion import Motion

__all__ = ["Bag"]

T = TypeVar("T")

#: Bytes of the messages that are read.
_LARGEST: Final = 512 * 2**20
#: Messages that are taken from SQLite at once.
_ROWS: Final = 1000
#: Topics that are taken before others.
_PREFERRED: Final = ("/reference/joint_states", "/joint_states")
#: Names of the pelvis's frame.
_PELVIS: Final = ("pelvis", "base_link")
_NS_PER_S: Final = 1_000_000_000


class Bag:
    """A bag, or an MCAP file, whoever wrote it.

    Args:
        path: of a file, or of a directory with metadata.yaml.

    Raises:
        RecordingError: there is no such file, or it is damaged.

    Attributes:
        path: as given.
        types: of each topic, the name of its message type and the encoding of its messages.
        is_foreign: whether it is no session: in SQLite, or with none of a session's topics.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._files = [
            _SqliteFile(part) if is_sqlite(part) else McapFile(part) for part in parts_of(path)
        ]
        self.types = {topic: kind for file in self._files for topic, kind in file.types.items()}
        self.counts = sum((file.counts for file in self._files), Counter[str]())
        in_sqlite = any(isinstance(file, _SqliteFile) for file in self._files)
        self.is_foreign = in_sqlite or self.types.keys().isdisjoint(STREAMS)

    @cached_property
    def evidence(self) -> tuple[str, ...]:
        """What the motion is made of, in short texts: the joints, their order, the pelvis."""
        topic, pose = self._joints_topic, self._pelvis
        pelvis = "not in the file: upright at the origin"
        if pose is not None:
            pelvis = f"{pose.child} in {pose.parent}, {counted(len(pose.times), 'transform')}"
        return (
            f"bag; {counted(self.counts[topic], 'message')} of {self.types[topic][0]} on {topic}",
            "named by the messages",
            pelvis,
        )

    def motion(self, fps: float | None = None) -> Motion:
        """The motion of its joint states, and of the pelvis in its transforms.

        Times are the stamps in the messages, or where these do not rise, those of publishing.

        Args:
            fps: frames per second; the rate of the joint states if None.

        Raises:
            RecordingError: the file is damaged, or has no joint states or several topics of them.
            MotionError: joints are missing, or `fps` is not a frame rate.
        """
        times, q = self._joints
        pose = self._pelvis
        root_pos, quat = np.zeros((len(times), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1))
        if pose is not None:
            root_pos, quat = pose.at(times)
        seconds = (times - times[0]) / _NS_PER_S
        return motion_of_poses(seconds, q, root_pos, quat, self.path, fps)

    @cached_property
    def _joints_topic(self) -> str:
        found = [topic for topic, kind in self.types.items() if kind in _JOINT_STATES]
        preferred = [topic for topic in _PREFERRED if topic in found] or found
        if len(preferred) == 1 or (preferred and preferred[0] in _PREFERRED):
            return preferred[0]
        if found:
            raise RecordingError(
                f"{self.path} has several topics of joint states: {', '.join(sorted(found))}.",
                f"Give a file with one of them, or with {_PREFERRED[1]}.",
            )
        kinds = sorted({kind for kind, _ in self.types.values()}) or ["no messages"]
        raise RecordingError(
            f"{self.path} is a bag without joint states; it has {', '.join(kinds[:8])}"
            f"{', ...' * (len(kinds) > 8)}.",
            "Give one with sensor_msgs/msg/JointState or foxglove.JointStates, or a session.",
        )

    @cached_property
    def _joints(self) -> tuple[Ints, Floats]:
        """Times (T,) int64, ns, and angles (T, 29), rad, of the messages with all joints."""
        topic = self._joints_topic
        decode = _JOINT_STATES[self.types[topic]]
        stamps, published, rows, seen = [], [], [], set[str]()
        columns: dict[tuple[str, ...], list[int] | None] = {}
        for messages in self._messages(topic):
            for time, data in zip(messages.publish_times.tolist(), messages.data, strict=True):
                joints = self._decoded(topic, decode, data)
                if joints.names not in columns:
                    names = [f"{name.removesuffix('_joint')}_joint" for name in joints.names]
                    seen.update(names)
                    whole = set(JOINT_NAMES) <= set(names)
                    columns[joints.names] = (
                        [names.index(name) for name in JOINT_NAMES] if whole else None
                    )
                order = columns[joints.names]
                if order is not None and len(joints.position) == len(joints.names):
                    rows.append([joints.position[i] for i in order])
                    stamps.append(joints.stamp)
                    published.append(time)
        if not columns:
            raise RecordingError(
                f"{topic} in {self.path} has no message in a chunk.",
                "Write the file with chunks, as `mcap compress` does.",
            )
        missing = [name for name in JOINT_NAMES if name not in seen]
        if missing:
            raise MotionError(
                f"{topic} in {self.path} lacks the joints {', '.join(missing)}.",
                "Give a motion of all 29 joints.",
            )
        if len(rows) < 2:
            raise RecordingError(
                f"{topic} in {self.path} has {counted(len(rows), 'message')} with all 29 joints.",
                "Give a bag in which each message has all of them.",
            )
        times = _rising(stamps, published)
        return times, np.array(rows, dtype=np.float64)

    @cached_property
    def _pelvis(self) -> _Poses | None:
        """The pelvis's poses in the frame above it; None without transforms of it."""
        found: dict[tuple[str, str], list[FramePose]] = {}
        for topic in sorted(topic for topic, kind in self.types.items() if kind in _TRANSFORMS):
            decode = _TRANSFORMS[self.types[topic]]
            for messages in self._messages(topic):
                for data in messages.data:
                    for one in self._decoded(topic, decode, data):
                        if one.child in _PELVIS:
                            found.setdefault((one.child, one.parent), []).append(one)
            if found:
                break
        if not found:
            return None
        (child, parent), poses = max(found.items(), key=lambda item: len(item[1]))
        times, first = np.unique([one.stamp for one in poses], return_index=True)
        pos = np.array([poses[i].pos for i in first])
        quat = np.array([poses[i].quat_wxyz for i in first])
        return _Poses(child, parent, times, pos, quat)

    def _messages(self, topic: str) -> Iterator[Messages]:
        size = 0
        for file in self._files:
            for _, messages in file.batches({topic}):
                size += sum(map(len, messages.data))
                if size > _LARGEST:
                    raise RecordingError(
                        f"{topic} in {self.path} has more than {_LARGEST / 2**20:g} MiB.",
                        "Give a shorter part of it.",
                    )
                yield messages

    def _decoded(self, topic: str, decode: Callable[[bytes], T], data: bytes) -> T:
        from google.protobuf.message import DecodeError

        try:
            return decode(data)
        except (ValueError, DecodeError) as error:
            raise RecordingError(
                f"A message on {topic} in {self.path} is not a {self.types[topic][0]}.",
                "Record it again.",
            ) from error


class _Poses(NamedTuple):
    """Where a frame is in another: times (N,) int64, ns, (N, 3) m and (N, 4)."""

    child: str
    parent: str
    times: Ints
    pos: Floats
    quat_wxyz: Floats

    def at(self, times: Ints) -> tuple[Floats, Floats]:
        """(T, 3) and (T, 4) at other times: on straight lines between them, and as at the ends."""
        from scipy.spatial.transform import Rotation, Slerp

        if np.array_equal(times, self.times):
            return self.pos, self.quat_wxyz
        if len(self.times) == 1:
            return np.tile(self.pos, (len(times), 1)), np.tile(self.quat_wxyz, (len(times), 1))
        known, wanted = ((one - self.times[0]) / _NS_PER_S for one in (self.times, times))
        wanted = np.clip(wanted, known[0], known[-1])
        pos = np.column_stack([np.interp(wanted, known, column) for column in self.pos.T])
        rotations = Rotation.from_quat(xyzw_from_wxyz(quat_normalize(self.quat_wxyz)))
        return pos, wxyz_from_xyzw(Slerp(known, rotations)(wanted).as_quat())


def _rising(stamps: list[int], published: list[int]) -> Ints:
    """The times that rise, (T,) int64, ns: the stamps in messages, if they do."""
    times = np.array(stamps, dtype=np.int64)
    return times if (np.diff(times) > 0).all() else np.array(published, dtype=np.int64)


class _SqliteFile:
    """A file of a bag of ROS 2, in SQLite: tables `topics` and `messages`.

    Attributes:
        types: as of `Bag`.
        counts: messages of each topic.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.counts: Counter[str] = Counter()
        self.types: dict[str, tuple[str, str]] = {}
        self._ids: dict[str, int] = {}
        tables = dict(self._rows("SELECT name, type FROM sqlite_master"))
        if any(tables.get(name) != "table" for name in ("topics", "messages")):
            raise self._error("it has no tables of topics and messages")
        topics = self._rows("SELECT id, name, type, serialization_format FROM topics")
        for number, name, kind, encoding in topics:
            self.types[str(name)] = str(kind), str(encoding)
            self._ids[str(name)] = int(number)
        counts = dict(self._rows("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        self.counts.update({name: counts.get(number, 0) for name, number in self._ids.items()})

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, in the order of their times."""
        for topic in sorted(topics & self._ids.keys()):
            query = "SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY timestamp, id"
            rows = list(self._rows(query, self._ids[topic]))
            for start in range(0, len(rows), _ROWS):
                times, data = zip(*rows[start : start + _ROWS], strict=True)
                stamps = np.array(times, dtype=np.int64)
                yield topic, Messages(stamps, stamps, data)

    def _rows(self, query: str, *values: int) -> Iterator[Any]:
        # Read as it is: without its journal, and without what its schema may run.
        address = f"file:{quote(str(self._path.absolute()))}?mode=ro&immutable=1"
        try:
            with closing(sqlite3.connect(address, uri=True)) as database:
                database.execute("PRAGMA trusted_schema = OFF")
                yield from database.execute(query, values)
        except (sqlite3.Error, OverflowError, ValueError) as error:
            raise self._error(str(error)) from error

    def _error(self, why: str) -> RecordingError:
        return RecordingError(
            f"{self._path} is no bag of ROS 2 in SQLite: {why}.", "Record it again, or as MCAP."
        )


def _foxglove_joints(data: bytes) -> JointAngles:
    from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

    message = JointStates.FromString(data)
    names = tuple(joint.name for joint in message.joints)
    position = [joint.position for joint in message.joints if joint.HasField("position")]
    return JointAngles(message.timestamp.ToNanoseconds(), names, position)


def _foxglove_transforms(data: bytes) -> list[FramePose]:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    return [
        FramePose(
            one.timestamp.ToNanoseconds(),
            one.parent_frame_id,
            one.child_frame_id,
            (one.translation.x, one.translation.y, one.translation.z),
            (one.rotation.w, one.rotation.x, one.rotation.y, one.rotation.z),
        )
        for one in FrameTransforms.FromString(data).transforms
    ]


_JOINT_STATES: Final = {
    ("sensor_msgs/msg/JointState", "cdr"): decode_joint_state,
    ("foxglove.JointStates", "protobuf"): _foxglove_joints,
}
_TRANSFORMS: Final = {
    ("tf2_msgs/msg/TFMessage", "cdr"): decode_tf,
    ("foxglove.FrameTransforms", "protobuf"): _foxglove_transforms,
}
"""By type and encoding of a topic, what decodes its messages."""
