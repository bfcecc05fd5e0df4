"""A motion from recorded poses: joint states and transforms, whoever recorded them.

Here Foxglove's JointStates and FrameTransforms are read, in protobuf, which `convert` writes, too.
Extras read others and give them to the same class.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol, TypeVar

import numpy as np

from g1stream.errors import MotionError, RecordingError
from g1stream.input_limits import FRAMES, LATEST_NS, NUMBER, UNPACKED
from g1stream.motion.motion import SMALLEST_QUAT, Motion, check_fps
from g1stream.motion.readers import Evidence
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import quat_normalize, wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.text import counted
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from google.protobuf.timestamp_pb2 import Timestamp

    from g1stream.motion.readers import MotionFile
    from g1stream.session.mcap_reader import Messages

__all__ = [
    "FOXGLOVE",
    "Decoders",
    "FramePose",
    "JointAngles",
    "RecordedMotion",
    "RecordingFile",
    "motion_of_poses",
]

T = TypeVar("T")

#: Topics that are taken before others.
_PREFERRED: Final = ("/reference/joint_states", "/joint_states")
#: Names of the pelvis's frame.
_PELVIS: Final = ("pelvis", "base_link")
_NS_PER_S: Final = 1_000_000_000
#: Of the two rows of times: the stamps in messages, and when they were published.
_STAMPS, _PUBLISHED = 0, 1
#: Times that differ by less are the same, s.
_SAME_TIME: Final = 1e-6


class JointAngles(NamedTuple):
    """What a message says of joints: its stamp, ns since the epoch, their names, and rad."""

    stamp: int
    names: tuple[str, ...]
    position: Sequence[float]


class FramePose(NamedTuple):
    """A transform: its stamp, ns since the epoch, the frames, (3) m and (4)."""

    stamp: int
    parent: str
    child: str
    pos: Sequence[float]
    quat_wxyz: Sequence[float]


class RecordingFile(Protocol):
    """A file of messages, such as `McapFile`.

    Attributes:
        types: of each topic, the name of its message type and the encoding of its messages.
        counts: messages of each topic.
        unread: bytes at its end that are no whole record.
    """

    counts: Counter[str]
    unread: int

    @property
    def types(self) -> dict[str, tuple[str, str]]:
        """By topic."""

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, in batches of one topic; those of a topic are in order."""


class Decoders(NamedTuple):
    """What decodes messages, by type and encoding; for anything else they raise a ValueError."""

    joint_states: Mapping[tuple[str, str], Callable[[bytes], JointAngles]]
    transforms: Mapping[tuple[str, str], Callable[[bytes], Sequence[FramePose]]]


class RecordedMotion:
    """The motion in a recording.

    Args:
        file: the recording; without `fps` the motion has the rate of its joint states.
        files: its parts, in order.
        decoders: of the messages that it may have.
    """

    def __init__(
        self, file: MotionFile, files: Sequence[RecordingFile], decoders: Decoders
    ) -> None:
        self._path, self._fps, self._files = file.path, file.fps, files
        self._decode_joints, self._decode_transforms = decoders
        self._types = {topic: kind for file in files for topic, kind in file.types.items()}
        self._unread = sum(file.unread for file in files)
        self._counts = sum((file.counts for file in files), Counter[str]())

    @cached_property
    def evidence(self) -> Evidence:
        """What the motion is made of: the joints, their order, the pelvis."""
        topic, pose = self._joints_topic, self._pelvis
        count, kind = counted(self._counts[topic], "message"), self._types[topic][0]
        used = {"file": f"bag; {count} of {kind} on {topic}"}
        used["joint order"] = "named by the messages"
        if pose is None:
            return Evidence(used, {"pelvis": "upright at the origin"})
        poses = counted(len(pose.pos), "transform")
        return Evidence({**used, "pelvis": f"{pose.child} in {pose.parent}, {poses}"})

    def motion(self) -> Motion:
        """The motion of its joint states, and of the pelvis in its transforms.

        Times are the stamps in the messages, or where those of the joint states do not rise or
        those of the transforms are not of the same time, all are those of publishing.

        Raises:
            RecordingError: the file is damaged, or has no joint states or several topics of them,
                or transforms of another time.
            MotionError: joints are missing.
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
                    f"The transforms of {pose.child} in {self._path} are from another time than "
                    "its joint states.",
                    "Record both together, or leave the transforms out.",
                )
            root_pos, quat = pose.at(times, clock)
        seconds = (times - times[0]) / _NS_PER_S
        motion = motion_of_poses(seconds, q, root_pos, quat, self._path, self._fps)
        if not self._unread:
            return motion
        lost = f"the last {counted(self._unread, 'byte')} of {self._path} are no whole record"
        return replace(motion, warnings=(*motion.warnings, f"{lost}, and not read"))

    @cached_property
    def _joints_topic(self) -> str:
        found = [topic for topic, kind in self._types.items() if kind in self._decode_joints]
        preferred = [topic for topic in _PREFERRED if topic in found] or found
        if len(preferred) == 1 or (preferred and preferred[0] in _PREFERRED):
            return preferred[0]
        if found:
            raise RecordingError(
                f"{self._path} has several topics of joint states: {', '.join(sorted(found))}.",
                f"Give a file with one of them, or with {_PREFERRED[1]}.",
            )
        kinds = sorted({f"{kind} in {encoding}" for kind, encoding in self._types.values()})
        raise RecordingError(
            f"{self._path} has no joint states that can be read; it has "
            f"{', '.join(kinds[:8]) or 'no messages'}{', ...' * (len(kinds) > 8)}.",
            "Give a bag with sensor_msgs/msg/JointState in cdr or foxglove.JointStates in "
            "protobuf, or a session.",
        )

    @cached_property
    def _joints(self) -> tuple[Ints, Floats]:
        """Times (2, T) int64, ns, and angles (T, 29), rad, of the messages with all joints."""
        topic = self._joints_topic
        decode = self._decode_joints[self._types[topic]]
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
                f"{topic} in {self._path} has no messages.",
                "Record while its publisher runs.",
            )
        missing = [name for name in JOINT_NAMES if name not in seen]
        if missing:
            raise MotionError(
                f"{topic} in {self._path} lacks the joints {', '.join(missing)}.",
                "Give a motion of all 29 joints.",
            )
        if len(rows) < 2:
            raise RecordingError(
                f"{topic} in {self._path} has {counted(len(rows), 'message')} with all 29 joints.",
                "Give a bag in which each message has all of them.",
            )
        return np.array([stamps, published], np.int64), np.array(rows, dtype=np.float64)

    @cached_property
    def _pelvis(self) -> _Poses | None:
        """The pelvis's poses in the frame above it; None without transforms of it."""
        found: dict[tuple[str, str], list[tuple[FramePose, int]]] = {}
        for topic in sorted(
            topic for topic, kind in self._types.items() if kind in self._decode_transforms
        ):
            decode = self._decode_transforms[self._types[topic]]
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
                f"A transform of {child} in {self._path} has a number that is not finite or beyond "
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
                        f"{topic} in {self._path} has more than {UNPACKED / 2**20:g} MiB.",
                        "Give a shorter part of it.",
                    )
                yield messages

    def _decoded(self, topic: str, decode: Callable[[bytes], T], data: bytes) -> T:
        from google.protobuf.message import DecodeError

        try:
            return decode(data)
        except (ValueError, DecodeError) as error:
            raise RecordingError(
                f"A message on {topic} in {self._path} is not a {self._types[topic][0]}.",
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


def _nanoseconds(timestamp: Timestamp) -> int:
    time = int(timestamp.ToNanoseconds())
    if not 0 <= time < LATEST_NS:
        raise ValueError("its time is not one of a recording")
    return time


def _joint_states(data: bytes) -> JointAngles:
    from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

    message = JointStates.FromString(data)
    names = tuple(joint.name for joint in message.joints)
    position = [joint.position for joint in message.joints if joint.HasField("position")]
    return JointAngles(_nanoseconds(message.timestamp), names, position)


def _transforms(data: bytes) -> list[FramePose]:
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


FOXGLOVE: Final = Decoders(
    {("foxglove.JointStates", "protobuf"): _joint_states},
    {("foxglove.FrameTransforms", "protobuf"): _transforms},
)
"""Decoders of Foxglove's messages."""


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
