"""A motion from recorded poses: joint states and transforms of any program.

This file reads Foxglove's JointStates and FrameTransforms in protobuf, which `convert` also writes.
Extras read other formats and pass them to the same class.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

import numpy as np

from g1stream.errors import MotionError, RecordingError
from g1stream.files import is_session
from g1stream.input_limits import LATEST_NS, NUMBER, UNPACKED
from g1stream.motion.motion import SMALLEST_QUAT, Motion, norm_warning
from g1stream.motion.readers import ATTACH, Evidence
from g1stream.optional import extension
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import quat_normalize, wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.session.mcap_reader import McapFile
from g1stream.session.motions import GAP_PERIODS, PAUSE_NS, motion_of_poses
from g1stream.session.records import ClockStep
from g1stream.session.source import files_of
from g1stream.session.streams import MAX_GAP_NS, without_steps
from g1stream.text import counted
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from google.protobuf.timestamp_pb2 import Timestamp

    from g1stream.motion.readers import MotionFile
    from g1stream.session.source import RecordingFile

__all__ = [
    "FOXGLOVE",
    "Decoders",
    "FramePose",
    "JointAngles",
    "RecordedMotion",
    "RecordedPoses",
    "open_recorded",
]

T = TypeVar("T")

#: Topics that are preferred to others.
_PREFERRED: Final = ("/reference/joint_states", "/joint_states", "/measured/joint_states")
#: Names of the pelvis's frame.
_PELVIS: Final = ("pelvis", "base_link")
_NS_PER_S: Final = 1_000_000_000
_UPRIGHT: Final = (1.0, 0.0, 0.0, 0.0)
#: Rows of the two kinds of times: stamps in messages, and publish times.
_STAMPS, _PUBLISHED = 0, 1
#: A joint that moves by less has not moved, rad.
_STANDS_STILL: Final = 0.05


class JointAngles(NamedTuple):
    """Joint angles of a message: stamp, ns since the epoch, joint names, and rad."""

    stamp: int
    names: tuple[str, ...]
    position: Sequence[float]


class FramePose(NamedTuple):
    """A transform: stamp, ns since the epoch, frames, position (3) m and quaternion (4)."""

    stamp: int
    parent: str
    child: str
    pos: Sequence[float]
    quat_wxyz: Sequence[float]


class RecordedPoses(NamedTuple):
    """T joint states, with the pelvis at the same times.

    Attributes:
        times: (T,) ns since the epoch.
        q: (T, 29) rad, motor order.
        root_pos, root_quat_wxyz: (T, 3) m and (T, 4), in the pelvis's parent frame.
        pelvis_known: whether there were transforms of it; otherwise it is upright at the origin.
        warnings: notes about the file.
    """

    times: Ints
    q: Floats
    root_pos: Floats
    root_quat_wxyz: Floats
    pelvis_known: bool
    warnings: tuple[str, ...]


class Decoders(NamedTuple):
    """Functions that decode messages, by type and encoding. They raise ValueError on bad data."""

    joint_states: Mapping[tuple[str, str], Callable[[bytes], JointAngles]]
    transforms: Mapping[tuple[str, str], Callable[[bytes], Sequence[FramePose]]]


class RecordedMotion:
    """The motion in a recording.

    Args:
        file: the recording; without `fps` the motion has the rate of its joint states.
        files: its parts, in order.
        decoders: decoders of the supported messages.

    Attributes:
        unread: bytes at the ends of the files that are incomplete records.
    """

    def __init__(
        self, file: MotionFile, files: Sequence[RecordingFile], decoders: Decoders
    ) -> None:
        self._path, self._fps, self._files = file.path, file.fps, files
        self._decode_joints, self._decode_transforms = decoders
        self._types = {topic: kind for file in files for topic, kind in file.types.items()}
        self.unread = sum(file.unread for file in files)
        self._counts = sum((file.counts for file in files), Counter[str]())

    @property
    def has_joints(self) -> bool:
        """Whether it has joint states that can be read."""
        return bool(self._joint_topics)

    @cached_property
    def evidence(self) -> Evidence:
        """The sources of the motion: joints, their order, and the pelvis."""
        topic, joints, pose = self._joints_topic, self._joints, self._pelvis
        count, kind = counted(self._counts[topic], "message"), self._types[topic][0]
        used = {
            "file": f"bag; {count} of {kind} on {topic}",
            "joint order": "named by the messages",
        }
        if joints.prefix:
            used["joint order"] += f", without the prefix {joints.prefix}"
        if joints.merged:
            used["joints"] = f"merged from messages with {joints.merged} of them"
        others = tuple(one for one in self._joint_topics if one != topic) + joints.not_used
        if pose is None:
            return Evidence(used, {"pelvis": "upright at the origin"}, others)
        used["pelvis"] = f"{pose.child} in {pose.parent}, {counted(len(pose.pos), 'transform')}"
        return Evidence(used, not_used=others + pose.not_used)

    def motion(self) -> Motion:
        """The motion from its joint states and the pelvis's transforms.

        Raises:
            RecordingError: as for `poses`; or nothing moves, or a value is not valid in a motion.
            MotionError: joints are missing.
        """
        poses = self.poses()
        motion = motion_of_poses(
            (poses.times - poses.times[0]) / _NS_PER_S,
            *(poses.q, poses.root_pos, poses.root_quat_wxyz),
            self._path,
            self._fps,
        )
        return replace(motion, warnings=(*motion.warnings, *poses.warnings))

    def poses(self) -> RecordedPoses:
        """Its joint states, with the pelvis's pose from the transforms.

        Times are the stamps in the messages. Publish times are used instead if the stamps of the
        joint states do not increase, or if those of the transforms do not overlap with them. Steps
        of a clock are removed.

        Raises:
            RecordingError: the file is damaged, was interrupted, or has no joint states or several
                topics of them, or transforms of another time.
            MotionError: joints are missing.
        """
        joints, pose, name = self._joints, self._pelvis, self._path.name
        q = joints.q
        root_pos, quat = np.zeros((len(q), 3)), np.tile(_UPRIGHT, (len(q), 1))
        clock = next(one for one in (_STAMPS, _PUBLISHED) if one == _PUBLISHED or self._fits(one))
        steps = _clock_steps(joints.clocks[clock], q, self._path)
        times = without_steps(joints.clocks[clock], steps)
        warnings = [
            f"{name}: its times jump by {step.step_ns / _NS_PER_S:+.3f} s, as if the clock was "
            "set; the jump was removed"
            for step in steps
        ]
        if pose is not None:
            if not pose.overlaps(joints.clocks, clock):
                raise RecordingError(
                    f"The transforms of {pose.child} in {self._path} are from another time than "
                    "its joint states.",
                    "Record both together, or remove the transforms.",
                )
            root_pos, quat = pose.at(times, without_steps(pose.clocks[clock], steps))
            furthest = f"transform {int(np.argmax(np.abs(pose.norms - 1.0)))}"
            warnings += [f"{name}: {text}" for text in norm_warning(pose.norms, furthest)]
        if self.unread:
            lost = (
                f"the last {counted(self.unread, 'byte')} of {self._path} are an incomplete record"
            )
            warnings.append(f"{lost} and were not read")
        return RecordedPoses(times, q, root_pos, quat, pose is not None, tuple(warnings))

    def _fits(self, clock: int) -> bool:
        """Whether a clock increases with the joint states, and matches the transforms.

        A clock without jumps is preferred to one with jumps.
        """
        clocks, pose = self._joints.clocks, self._pelvis
        intervals = np.diff(clocks)
        rises, leap = (intervals[clock] > 0).all(), intervals.max(axis=1) > PAUSE_NS
        other_is_better = leap[clock] and not leap[1 - clock]
        return bool(rises and not other_is_better) and (
            pose is None or pose.overlaps(clocks, clock)
        )

    @cached_property
    def _joint_topics(self) -> list[str]:
        return sorted(topic for topic, kind in self._types.items() if kind in self._decode_joints)

    @cached_property
    def _joints_topic(self) -> str:
        found = self._joint_topics
        preferred = [topic for topic in _PREFERRED if topic in found] or found
        if len(preferred) == 1 or (preferred and preferred[0] in _PREFERRED):
            return preferred[0]
        if found:
            raise RecordingError(
                f"{self._path} has several topics of joint states: {', '.join(found)}.",
                f"Give a file with one of them, or with {_PREFERRED[1]}.",
            )
        kinds = sorted({f"{kind} in {encoding}" for kind, encoding in self._types.values()})
        has = f"{', '.join(kinds[:8])}{', ...' * (len(kinds) > 8)}" if kinds else "no messages"
        raise RecordingError(
            f"{self._path} has no supported joint states, only {has}.",
            "Give a bag with sensor_msgs/msg/JointState in cdr or foxglove.JointStates in "
            f"protobuf, or a session. {ATTACH}",
        )

    @cached_property
    def _joints(self) -> _Joints:
        """The messages with all joints, or merged messages with some joints each."""
        topic = self._joints_topic
        found: dict[tuple[str, ...], list[_Row]] = {}
        for number, (published, joints) in enumerate(self._decoded(topic, self._decode_joints)):
            rows = found.setdefault(joints.names, [])
            if len(joints.position) == len(joints.names):
                rows.append((number, joints.stamp, published, joints.position))
        if not found:
            raise RecordingError(
                f"{topic} in {self._path} has no messages.",
                "Record while the publisher is running.",
            )
        prefix = _prefix([name for names in found for name in names])
        kinds: dict[tuple[str, ...], list[_Row]] = {}
        for names, rows in found.items():
            short = (f"{name[len(prefix) :].removesuffix('_joint')}_joint" for name in names)
            kinds.setdefault(tuple(short), []).extend(rows)
        missing = [name for name in JOINT_NAMES if not any(name in names for names in kinds)]
        if missing:
            raise MotionError(
                f"{topic} in {self._path} lacks the joints {', '.join(missing)}.",
                "Give a motion of all 29 joints.",
            )
        whole = [names for names in kinds if {*JOINT_NAMES} <= {*names}]
        some = [] if whole else [names for names in kinds if not {*JOINT_NAMES}.isdisjoint(names)]
        if whole:
            rows = sorted(row for names in whole for row in _in_order(names, kinds[names]))
            clocks = np.array([row[1:3] for row in rows], np.int64).reshape(-1, 2).T
            q = np.array([row[3] for row in rows], dtype=np.float64)
        else:
            clocks, q = _merged({names: kinds[names] for names in some}, self._path)
        if len(q) < 2:
            raise RecordingError(
                f"{topic} in {self._path} has {counted(len(q), 'message')} with all 29 joints.",
                "Give a bag in which each message has all of them.",
            )
        not_used = tuple(
            f"{counted(len(rows), 'message')} with {counted(len(names), 'other joint')}"
            for names, rows in kinds.items()
            if names not in {*whole, *some}
        )
        return _Joints(clocks, q, prefix, " and ".join(str(len(one)) for one in some), not_used)

    @cached_property
    def _pelvis(self) -> _Poses | None:
        """The pelvis's poses in its parent frame; None without transforms."""
        names = {self._joints.prefix + name for name in _PELVIS}
        found: dict[tuple[str, str], list[tuple[FramePose, int]]] = {}
        for topic in sorted(
            t for t, kind in self._types.items() if kind in self._decode_transforms
        ):
            for published, transforms in self._decoded(topic, self._decode_transforms):
                for one in transforms:
                    if (one.child in names or _is_pelvis(one.child)) and not _is_pelvis(one.parent):
                        found.setdefault((one.child, one.parent), []).append((one, published))
            if any(child in names for child, _ in found):
                break
        if not found:
            return None
        # With the joints' prefix, or with another, such as that of g1stream's measured robot.
        frames = sorted(found, key=lambda one: (one[0] not in names, -len(found[one])))
        (child, parent), *others = frames
        clocks = np.array([(one.stamp, time) for one, time in found[frames[0]]], np.int64).T
        pos = np.array([one.pos for one, _ in found[frames[0]]])
        quat = np.array([one.quat_wxyz for one, _ in found[frames[0]]])
        valid = (np.abs(np.hstack([pos, quat])) <= NUMBER).all(axis=1)
        if not (valid & (np.abs(quat).max(axis=1) > SMALLEST_QUAT)).all():
            raise RecordingError(
                f"A transform of {child} in {self._path} has a number that is not finite or beyond "
                f"{NUMBER:g}, or a zero quaternion.",
                "Record it again.",
            )
        return _Poses(child, parent, clocks, pos, quat, tuple(f"{c} in {p}" for c, p in others))

    def _decoded(
        self, topic: str, decoders: Mapping[tuple[str, str], Callable[[bytes], T]]
    ) -> Iterator[tuple[int, T]]:
        """When each message of a topic was published, ns, and what it says."""
        from google.protobuf.message import DecodeError

        decode, size = decoders[self._types[topic]], 0
        for file in self._files:
            for _, messages in file.batches({topic}):
                size += sum(map(len, messages.data))
                if size > UNPACKED:
                    raise RecordingError(
                        f"{topic} in {self._path} has more than {UNPACKED / 2**20:g} MiB.",
                        "Give a shorter part of it.",
                    )
                for time, data in zip(messages.publish_times.tolist(), messages.data, strict=True):
                    try:
                        found = decode(data)
                    except (ValueError, DecodeError) as error:
                        raise RecordingError(
                            f"A message on {topic} in {self._path} is not a "
                            f"{self._types[topic][0]}.",
                            "Record it again.",
                        ) from error
                    yield time, found


#: A message of joints: its number, stamp and publish time, ns, and the angles, rad.
_Row = tuple[int, int, int, Sequence[float]]


class _Joints(NamedTuple):
    """Joint states: times (2, T) int64, ns, and (T, 29) rad; and how messages were interpreted."""

    clocks: Ints
    q: Floats
    prefix: str
    merged: str
    not_used: tuple[str, ...]


def _prefix(names: Sequence[str]) -> str:
    """The common prefix of all names, such as `g1/`, if they are not joint names without it."""
    if any(f"{name.removesuffix('_joint')}_joint" in JOINT_NAMES for name in names):
        return ""
    first, last = min(names, default=""), max(names, default="")
    return first[: next((i for i, one in enumerate(first) if last[i : i + 1] != one), len(first))]


def _in_order(names: tuple[str, ...], rows: list[_Row]) -> Iterator[_Row]:
    """Messages with all 29 joints, in motor order."""
    order = [names.index(name) for name in JOINT_NAMES]
    return ((*row[:3], [row[3][i] for i in order]) for row in rows)


def _merged(kinds: Mapping[tuple[str, ...], list[_Row]], path: Path) -> tuple[Ints, Floats]:
    """Times (2, T) of the most frequent messages, ns, and all joints (T, 29) at these, rad.

    Angles are interpolated linearly between the messages of a kind, and not extrapolated.
    """
    series = [
        (
            names,
            np.array([row[1:3] for row in rows], np.int64).T,
            np.array([row[3] for row in rows]),
        )
        for names, rows in sorted(kinds.items(), key=lambda one: len(one[1]))
        if rows
    ]
    rising = [
        clock
        for clock in (_STAMPS, _PUBLISHED)
        if all((np.diff(clocks[clock]) > 0).all() for _, clocks, _ in series)
    ]
    if not rising or len(series) < len(kinds):
        raise RecordingError(
            f"The joint states of {path} are split over several messages, and their times do "
            "not increase.",
            "Record all joints in each message.",
        )
    clock, clocks = rising[0], series[-1][1]
    first = max(one[clock][0] for _, one, _ in series) - MAX_GAP_NS
    last = min(one[clock][-1] for _, one, _ in series) + MAX_GAP_NS
    clocks = clocks[:, (clocks[clock] >= first) & (clocks[clock] <= last)]
    q = np.empty((clocks.shape[1], N_JOINTS))
    for names, own, angles in series:
        at, known = ((one - first) / _NS_PER_S for one in (clocks[clock], own[clock]))
        for joint in {*JOINT_NAMES} & {*names}:
            q[:, JOINT_NAMES.index(joint)] = np.interp(at, known, angles[:, names.index(joint)])
    return clocks, q


def _is_pelvis(frame: str) -> bool:
    return frame.rpartition("/")[2] in _PELVIS


def _clock_steps(times: Ints, q: Floats, path: Path) -> list[ClockStep]:
    """Steps of the clock of poses (T, 29), ns, detected where the poses continue without a jump.

    Raises:
        RecordingError: the poses also jump where the clock does.
    """
    intervals, change = np.diff(times), np.abs(np.diff(q, axis=0)).max(axis=1)
    period, steps = max(1, int(np.median(intervals))), []
    odd = (intervals > max(MAX_GAP_NS, GAP_PERIODS * period)) | (intervals < -MAX_GAP_NS)
    for i in np.flatnonzero(odd).tolist():
        interval = int(intervals[i])
        usual = float(np.append(change[max(0, i - 5) : i], change[i + 1 : i + 6]).mean())
        leap = not 0 <= interval <= max(PAUSE_NS, GAP_PERIODS * period)
        goes_on = change[i] <= 3.0 * usual + _STANDS_STILL
        # A robot that moves would have moved further in a pause of the messages.
        if goes_on and (leap or usual * interval / period > 5.0 * change[i] + 2.0 * _STANDS_STILL):
            steps.append(ClockStep(at_ns=int(times[i + 1]), step_ns=interval - period))
        elif leap:
            raise RecordingError(
                f"{path} was interrupted: its clock goes from {(times[i] - times[0]) / 1e9:.1f} to "
                f"{(times[i + 1] - times[0]) / 1e9:.1f} s, and a joint by {change[i]:.2f} rad.",
                "Record the motion without interruption, or cut the file there and give a part.",
            )
    return steps


class _Poses(NamedTuple):
    """Poses of a frame in another: times (2, N) int64, ns, (N, 3) m and (N, 4)."""

    child: str
    parent: str
    clocks: Ints
    pos: Floats
    quat_wxyz: Floats
    not_used: tuple[str, ...]

    @property
    def norms(self) -> Floats:
        """(N,) norms of the quaternions."""
        return np.asarray(np.linalg.norm(self.quat_wxyz, axis=1))

    def overlaps(self, clocks: Ints, clock: int) -> bool:
        """Whether their time overlaps other times (2, T). A single pose is valid at any time."""
        own, other = self.clocks[clock], clocks[clock]
        between = own.min() <= other.max() and other.min() <= own.max()
        return len(own) == 1 or bool(own.min() < own.max() and between)

    def at(self, times: Ints, own: Ints) -> tuple[Floats, Floats]:
        """(T, 3) and (T, 4) at times (T,), interpolated linearly, constant beyond the ends.

        `own` are their times (N,).
        """
        from scipy.spatial.transform import Rotation, Slerp

        own, first = np.unique(own, return_index=True)
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
        raise ValueError("its time is not plausible for a recording")
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


def open_recorded(file: MotionFile) -> RecordedMotion:
    """Open joint states recorded by another program or by `convert`.

    Raises:
        ConfigError: the extra that reads it is not installed.
        RecordingError: it is damaged.
    """
    parts = files_of(file.path)
    in_ros = not is_session(parts[0])  # SQLite, or compressed as a whole
    files = [] if in_ros else [McapFile(part) for part in parts]
    kinds = {kind for one in files for kind, _ in one.types.values()}
    if in_ros or "sensor_msgs/msg/JointState" in kinds:
        recorded: RecordedMotion = extension("read_bag")(file)
        return recorded
    return RecordedMotion(file, files, FOXGLOVE)
