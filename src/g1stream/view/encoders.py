"""Encode poses and joint states as Foxglove's protobuf messages, in batches.

Messages of one channel differ only in their numbers. Therefore the official class serialises one
message with placeholders for the numbers. A batch is encoded with numpy by copying these bytes and
writing the numbers over the placeholders.

This needs fields of fixed width. Doubles have 8 bytes. The two varints of a timestamp are padded to
five bytes, which the protobuf encoding allows and every decoder accepts. Five bytes hold 35 bits,
enough for all seconds in 63 bits of nanoseconds.
"""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from g1stream.errors import ConfigError
from g1stream.robot.kinematics import forward_kinematics, local_transforms
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from google.protobuf.message import Message
    from google.protobuf.timestamp_pb2 import Timestamp
    from numpy.typing import ArrayLike, NDArray

    from g1stream.robot.model import G1

__all__ = [
    "GHOST_PREFIX",
    "IDENTITY_POSE",
    "MEASURED_PREFIX",
    "WORLD_FRAME",
    "JointStatesTemplate",
    "TransformsEncoder",
    "link_frames",
]

WORLD_FRAME: Final = "world"
"""Default name of the world frame."""

MEASURED_PREFIX: Final = "measured/"
"""Prefix of the measured robot's frame names; it shares the world frame with the reference."""

GHOST_PREFIX: Final = "ghost/"
"""Prefix of the frames of the ghost, which has the reference's joints on the measured pelvis."""

IDENTITY_POSE: Final = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
"""Position (3,) m and quaternion (4,) wxyz of a frame that coincides with its parent."""

_NS_PER_S: Final = 1_000_000_000

# Every placeholder contains 0xFF, which UTF-8 text never contains, so a frame name cannot match.
_SECONDS_PLACEHOLDER: Final = 2**35 - 1
_NANOS_PLACEHOLDER: Final = _NS_PER_S - 1
_BEFORE, _AFTER = b"\xff\xfe", b"\xe0\x7f"  # of the index in a double

#: Encoding of a timestamp: tags of seconds and nanoseconds, and for each varint the shifts of its
#: five bytes and their continuation bits.
_TAGS: Final = (0x08, 0x10)
_SHIFTS: Final = 7 * np.arange(5)
_MORE: Final = np.array([0x80, 0x80, 0x80, 0x80, 0])
_TIMESTAMP_SIZE: Final = 12


class TransformsEncoder:
    """Encodes poses of a robot as foxglove.FrameTransforms, for the tree of links below the world.

    Args:
        robot: the robot.
        prefix: prefix of link names in frame names.
        world: name of the world frame, which no link may have.
        flat: put every link directly under the world instead of under its parent.
        single: round poses to single precision, which takes half the space in a compressed file.

    Raises:
        ConfigError: the frame of a link has the name of the world frame.
    """

    def __init__(
        self,
        robot: G1,
        prefix: str = "",
        *,
        world: str = WORLD_FRAME,
        flat: bool = False,
        single: bool = False,
    ) -> None:
        parents, frames = link_frames(robot, prefix, world)
        if flat:
            parents = [world] * len(frames)
        self._robot = robot
        self._poses = forward_kinematics if flat else local_transforms
        self._dtype = np.float32 if single else np.float64
        message = FrameTransforms()
        for link, (parent, frame) in enumerate(zip(parents, frames, strict=True)):
            transform = message.transforms.add(parent_frame_id=parent, child_frame_id=frame)
            _set_placeholder(transform.timestamp)
            x, y, z, qw, qx, qy, qz = (_double_placeholder(7 * link + i) for i in range(7))
            transform.translation.x, transform.translation.y, transform.translation.z = x, y, z
            transform.rotation.w, transform.rotation.x = qw, qx
            transform.rotation.y, transform.rotation.z = qy, qz
        self._template = _Template(message, (len(frames), 7), n_times=len(frames))

    def encode(
        self,
        times_ns: ArrayLike,
        joint_pos: Floats,
        root_pos: Floats,
        root_quat_wxyz: Floats,
    ) -> NDArray[np.uint8]:
        """Encode one message per time.

        Args:
            times_ns: (T,) int64, ns since the epoch.
            joint_pos: (T, 29) rad, motor order.
            root_pos: (T, 3) position of the root link in the world, m; or (3,) for all times.
            root_quat_wxyz: (T, 4) its unit quaternion, wxyz; or (4,) for all times.

        Returns:
            (T, size) uint8; each row is one message.
        """
        poses = self._poses(self._robot, joint_pos, root_pos, root_quat_wxyz)
        values = np.concatenate((poses.pos, poses.quat_wxyz), axis=2, dtype=self._dtype)
        return self._template.fill(times_ns, values)


def link_frames(robot: G1, prefix: str, world: str) -> tuple[list[str], list[str]]:
    """Names of the links' parent frames, of which the root's is `world`, and of their frames.

    Raises:
        ConfigError: the frame of a link has the name of the world frame.
    """
    frames = [f"{prefix}{name}" for name in robot.link_names]
    if world in frames:
        raise ConfigError(
            f"The world frame {world!r} has the name of a link of {robot.name}.",
            "Rename the link in the URDF.",
        )
    return [world if parent < 0 else frames[parent] for parent in robot.parent], frames


class JointStatesTemplate:
    """Encodes foxglove.JointStates with the same fields for every joint.

    Args:
        joint_names: (J) names.
        fields: some of `position` (rad), `velocity` (rad/s), `acceleration` (rad/s^2) and `effort`
            (N·m), in the order of the columns of `encode`.
    """

    def __init__(self, joint_names: Sequence[str], fields: Sequence[str]) -> None:
        message = JointStates()
        _set_placeholder(message.timestamp)
        for joint, name in enumerate(joint_names):
            state = message.joints.add(name=name)
            for i, field in enumerate(fields):
                setattr(state, field, _double_placeholder(joint * len(fields) + i))
        self._template = _Template(message, (len(joint_names), len(fields)), n_times=1)

    def encode(self, times_ns: ArrayLike, *columns: ArrayLike) -> NDArray[np.uint8]:
        """Encode one message per time.

        Args:
            times_ns: (T,) int64, ns since the epoch, not negative.
            columns: (T, J) each, one per field, in the order of `fields`.

        Returns:
            (T, size) uint8; each row is one message.

        Raises:
            ValueError: columns are missing or do not fit the joints, or a time is negative.
        """
        return self._template.fill(times_ns, np.stack([np.asarray(c) for c in columns], axis=-1))

    def decode(self, messages: Sequence[bytes]) -> Floats:
        """Decode messages of `encode` into numbers (T, J, fields).

        Raises:
            ValueError: a message is of another kind.
        """
        return self._template.read(messages)


class _Template:
    """One serialised message with the offsets of its doubles and timestamps."""

    def __init__(self, message: Message, shape: tuple[int, int], n_times: int) -> None:
        data: bytes = message.SerializeToString()
        self._bytes = np.frombuffer(data, dtype=np.uint8)
        self._shape = shape
        doubles = _find(data, _BEFORE + b"(....)" + _AFTER, shape[0] * shape[1])
        self._doubles = _offsets(sorted(doubles, key=lambda one: int.from_bytes(one[1], "little")))
        placeholder = np.array([_SECONDS_PLACEHOLDER]), np.array([_NANOS_PLACEHOLDER])
        stamp = re.escape(_timestamp_bytes(*placeholder).tobytes())
        self._timestamps = _offsets(_find(data, stamp, n_times))

    def fill(self, times_ns: ArrayLike, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Make (T, size) copies of the message, each with its time and row of (T, ...) doubles."""
        times = np.asarray(times_ns, dtype=np.int64)
        if values.shape != (len(times), *self._shape):
            raise ValueError(f"shape {values.shape} instead of {(len(times), *self._shape)}")
        if np.any(times < 0):
            raise ValueError(f"a time is negative: {times.min()} ns")
        rows = np.empty((len(times), len(self._bytes)), dtype=np.uint8)
        rows[:] = self._bytes
        _windows(rows, "<f8")[:, self._doubles] = values.reshape(len(times), len(self._doubles))
        packed = _timestamp_bytes(*np.divmod(times, _NS_PER_S)).view(f"V{_TIMESTAMP_SIZE}")
        _windows(rows, f"V{_TIMESTAMP_SIZE}")[:, self._timestamps] = packed
        return rows

    def read(self, messages: Sequence[bytes]) -> Floats:
        """Read the doubles (T, ...) from messages of `fill`."""
        if any(len(message) != len(self._bytes) for message in messages):
            raise ValueError(f"a message does not have {len(self._bytes)} bytes")
        rows = np.frombuffer(b"".join(messages), np.uint8).reshape(-1, len(self._bytes))
        doubles: Floats = _windows(rows, "<f8")[:, self._doubles]
        return doubles.reshape(-1, *self._shape)


def _windows(rows: NDArray[np.uint8], dtype: str) -> NDArray[Any]:
    """View (T, size) bytes as (T, size - itemsize + 1) unaligned items, one at every byte."""
    item = np.dtype(dtype)
    n_rows, size = rows.shape
    shape = (n_rows, size - item.itemsize + 1)
    windows: NDArray[Any] = np.ndarray(shape, item, buffer=rows.data, strides=(size, 1))
    return windows


def _timestamp_bytes(seconds: Ints, nanos: Ints) -> NDArray[np.uint8]:
    """(T, 12) bodies of google.protobuf.Timestamp, with both varints padded to five bytes."""
    packed = np.empty((len(seconds), 2, _TIMESTAMP_SIZE // 2), dtype=np.uint8)
    packed[:, :, 0] = _TAGS
    numbers = np.stack((seconds, nanos), axis=-1)[:, :, np.newaxis]
    packed[:, :, 1:] = (numbers >> _SHIFTS) & 0x7F | _MORE
    return packed.reshape(-1, _TIMESTAMP_SIZE)


def _set_placeholder(timestamp: Timestamp) -> None:
    timestamp.seconds, timestamp.nanos = _SECONDS_PLACEHOLDER, _NANOS_PLACEHOLDER


def _double_placeholder(index: int) -> float:
    return float(struct.unpack("<d", _BEFORE + struct.pack("<I", index) + _AFTER)[0])


def _find(data: bytes, pattern: bytes, count: int) -> list[re.Match[bytes]]:
    """All matches of a placeholder's pattern; there must be `count`."""
    found = list(re.finditer(pattern, data, re.DOTALL))
    if len(found) != count:
        raise ValueError(f"{len(found)} of {count} placeholders found in the serialised message")
    return found


def _offsets(matches: Sequence[re.Match[bytes]]) -> NDArray[np.intp]:
    return np.array([one.start() for one in matches], dtype=np.intp)
