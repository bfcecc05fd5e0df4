"""Bags of ROS 2 and MCAP files of others: a motion from their joint states and transforms.

Read are sensor_msgs/JointState with tf2_msgs/TFMessage, in CDR, and Foxglove's JointStates with
FrameTransforms, in protobuf, from MCAP and from SQLite, one file or a directory of parts.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from contextlib import closing
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar
from urllib.parse import quote

import numpy as np

from g1stream.dds.ros2 import FramePose, JointAngles, decode_joint_state, decode_tf
from g1stream.errors import MotionError, RecordingError
from g1stream.files import is_sqlite
from g1stream.input_limits import LATEST_NS, NUMBER, UNPACKED
from g1stream.motion.motion import SMALLEST_QUAT
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import quat_normalize, wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.session.mcap_reader import McapFile
from g1stream.session.parts import parts_of
from g1stream.session.poses import motion_of_poses
from g1stream.session.source import Messages
from g1stream.session.streams import STREAMS, Reference
from g1stream.text import counted
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from google.protobuf.timestamp_pb2 import Timestamp

    from g1stream.motion.motion import Motion

__all__ = ["Bag"]

T = TypeVar("T")

#: Messages that are taken from SQLite at once.
_ROWS: Final = 100
#: Topics that are taken before others.
_PREFERRED: Final = ("/reference/joint_states", "/joint_states")
#: Names of the pelvis's frame.
_PELVIS: Final = ("pelvis", "base_link")
_NS_PER_S: Final = 1_000_000_000
#: Of the two rows of times: the stamps in messages, and when they were published.
_STAMPS, _PUBLISHED = 0, 1


class Bag:
    """A bag, or an MCAP file, whoever wrote it.

    Args:
        path: of a file, or of a directory with metadata.yaml.

    Raises:
        RecordingError: there is no such file, or it is damaged.

    Attributes:
        path: as given.
        types: of each topic, the name of its message type and the encoding of its messages.
        is_foreign: whether it is no session: in SQLite, or with none of a session's topics, or with
            joint states and nothing that only sessions have, as a robot's own topics in a bag.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._files = [
            _SqliteFile(part) if is_sqlite(part) else McapFile(part) for part in parts_of(path)
        ]
        self.types = {topic: kind for file in self._files for topic, kind in file.types.items()}
        self.counts = sum((file.counts for file in self._files), Counter[str]())
        in_sqlite = any(isinstance(file, _SqliteFile) for file in self._files)
        ours = Reference.topic in self.types or any(
            isinstance(file, McapFile) and file.metadata for file in self._files
        )
        has_joints = any(kind in _JOINT_STATES for kind in self.types.values())
        no_session = self.types.keys().isdisjoint(STREAMS) or (has_joints and not ours)
        self.is_foreign = in_sqlite or no_session

    @cached_property
    def evidence(self) -> tuple[str, ...]:
        """What the motion is made of, in short texts: the joints, their order, the pelvis."""
        topic, pose = self._joints_topic, self._pelvis
        pelvis = "not in the file: upright at the origin"
        if pose is not None:
            pelvis = f"{pose.child} in {pose.parent}, {counted(len(pose.pos), 'transform')}"
        return (
            f"bag; {counted(self.counts[topic], 'message')} of {self.types[topic][0]} on {topic}",
            "named by the messages",
            pelvis,
        )

    def motion(self, fps: float | None = None) -> Motion:
        """The motion of its joint states, and of the pelvis in its transforms.

        Times are the stamps in the messages, or where those of the joint states do not rise or
        those of the transforms are not of the same time, all are those of publishing.

        Args:
            fps: frames per second; the rate of the joint states if None.

        Raises:
            RecordingError: the file is damaged, or has no joint states or several topics of them,
                or transforms of another time.
            MotionError: joints are missing, or `fps` is not a frame rate.
        """
        clocks, q = self._joints
        pose = self._pelvis
        root_pos, quat = np.zeros((len(q), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(q), 1))
        rise = (np.diff(clocks[_STAMPS]) > 0).all()
        stamped = rise and (pose is None or pose.overlaps(clocks, _STAMPS))
        clock = _STAMPS if stamped else _PUBLISHED
        times = clocks[clock]
        if pose is not None:
            if not pose.overlaps(clocks, clock):
                raise RecordingError(
                    f"The transforms of {pose.child} in {self.path} are from another time than "
                    "its joint states.",
                    "Record both together, or leave the transforms out.",
                )
            root_pos, quat = pose.at(times, clock)
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
        """Times (2, T) int64, ns, and angles (T, 29), rad, of the messages with all joints."""
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
        return np.array([stamps, published], np.int64), np.array(rows, dtype=np.float64)

    @cached_property
    def _pelvis(self) -> _Poses | None:
        """The pelvis's poses in the frame above it; None without transforms of it."""
        found: dict[tuple[str, str], list[tuple[FramePose, int]]] = {}
        for topic in sorted(topic for topic, kind in self.types.items() if kind in _TRANSFORMS):
            decode = _TRANSFORMS[self.types[topic]]
            for messages in self._messages(topic):
                for time, data in zip(messages.publish_times.tolist(), messages.data, strict=True):
                    for one in self._decoded(topic, decode, data):
                        if one.child in _PELVIS:
                            found.setdefault((one.child, one.parent), []).append((one, time))
            if found:
                break
        if not found:
            return None
        (child, parent), poses = max(found.items(), key=lambda item: len(item[1]))
        clocks = np.array([(one.stamp, time) for one, time in poses], np.int64).T
        pos = np.array([one.pos for one, _ in poses])
        quat = np.array([one.quat_wxyz for one, _ in poses])
        valid = (np.abs(np.hstack([pos, quat])) <= NUMBER).all(axis=1)
        if not (valid & (np.abs(quat).max(axis=1) > SMALLEST_QUAT)).all():
            raise RecordingError(
                f"A transform of {child} in {self.path} has a number that is not finite or beyond "
                f"{NUMBER:g}, or a zero quaternion.",
                "Record it again.",
            )
        return _Poses(child, parent, clocks, pos, quat)

    def _messages(self, topic: str) -> Iterator[Messages]:
        size = 0
        for file in self._files:
            for _, messages in file.batches({topic}):
                size += sum(map(len, messages.data))
                if size > UNPACKED:
                    raise RecordingError(
                        f"{topic} in {self.path} has more than {UNPACKED / 2**20:g} MiB.",
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
    """Where a frame is in another: times (2, N) int64, ns, (N, 3) m and (N, 4)."""

    child: str
    parent: str
    clocks: Ints
    pos: Floats
    quat_wxyz: Floats

    def overlaps(self, clocks: Ints, clock: int) -> bool:
        """Whether they are of the same time as others (2, T); a single one is of any time."""
        own, other = self.clocks[clock], clocks[clock]
        between = own.min() <= other.max() and other.min() <= own.max()
        return len(own) == 1 or bool(own.min() < own.max() and between)

    def at(self, times: Ints, clock: int) -> tuple[Floats, Floats]:
        """(T, 3) and (T, 4) at other times: on straight lines between them, and as at the ends."""
        from scipy.spatial.transform import Rotation, Slerp

        own, first = np.unique(self.clocks[clock], return_index=True)
        own_pos, own_quat = self.pos[first], self.quat_wxyz[first]
        if np.array_equal(times, own):
            return own_pos, own_quat
        if len(own) == 1:
            return np.tile(own_pos, (len(times), 1)), np.tile(own_quat, (len(times), 1))
        known, wanted = ((one - own[0]) / _NS_PER_S for one in (own, times))
        wanted = np.clip(wanted, known[0], known[-1])
        pos = np.column_stack([np.interp(wanted, known, column) for column in own_pos.T])
        rotations = Rotation.from_quat(xyzw_from_wxyz(quat_normalize(own_quat)))
        return pos, wxyz_from_xyzw(Slerp(known, rotations)(wanted).as_quat())


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
            if not isinstance(number, int):
                raise self._error("a topic has no number")
            self.types[str(name)] = str(kind), str(encoding)
            self._ids[str(name)] = number
        counts = dict(self._rows("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        self.counts.update({name: counts.get(number, 0) for name, number in self._ids.items()})

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, in the order of their times."""
        for topic in sorted(topics & self._ids.keys()):
            query = "SELECT timestamp, data FROM messages WHERE topic_id = ? ORDER BY timestamp, id"
            rows = self._rows(query, self._ids[topic])
            while some := list(islice(rows, _ROWS)):
                times, data = zip(*some, strict=True)
                if not all(isinstance(time, int) and 0 <= time < LATEST_NS for time in times):
                    raise self._error("a message has no time")
                if not all(isinstance(one, bytes) for one in data):
                    raise self._error("a message has no content")
                published = np.array(times, dtype=np.int64)
                yield topic, Messages(published, published, data)

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


def _nanoseconds(timestamp: Timestamp) -> int:
    time = int(timestamp.ToNanoseconds())
    if not 0 <= time < LATEST_NS:
        raise ValueError("its time is not one of a recording")
    return time


def _foxglove_joints(data: bytes) -> JointAngles:
    from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

    message = JointStates.FromString(data)
    names = tuple(joint.name for joint in message.joints)
    position = [joint.position for joint in message.joints if joint.HasField("position")]
    return JointAngles(_nanoseconds(message.timestamp), names, position)


def _foxglove_transforms(data: bytes) -> list[FramePose]:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    return [
        FramePose(
            _nanoseconds(one.timestamp),
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
