"""Encodes a batch of Foxglove's protobuf messages at once, by patching a serialised template.

Messages of one channel differ only in their numbers. So one message is serialised by the official
class with placeholders for the numbers; a batch is encoded by copying these bytes and writing the
numbers over the placeholders, in numpy.

That needs fields of fixed width. Doubles have 8 bytes. The two varints of a timestamp are padded to
five bytes, which the protobuf encoding allows and every decoder accepts. Five bytes hold 35 bits:
all the seconds that 63 bits of nanoseconds can express.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

if TYPE_CHECKING:
    from collections.abc import Sequence

    from google.protobuf.message import Message
    from google.protobuf.timestamp_pb2 import Timestamp
    from numpy.typing import ArrayLike, NDArray

__all__ = ["FrameTransformsTemplate", "JointStatesTemplate"]

_NS_PER_S: Final = 1_000_000_000

# Every placeholder contains 0xFF, which no UTF-8 text does: no frame name can be taken for one.
_SECONDS_PLACEHOLDER: Final = 2**35 - 1
_NANOS_PLACEHOLDER: Final = _NS_PER_S - 1
_DOUBLE_PLACEHOLDER: Final = struct.Struct("<2sI2s")

_SECONDS_TAG: Final = 0x08
_NANOS_TAG: Final = 0x10
_TIMESTAMP_SIZE: Final = 12


class FrameTransformsTemplate:
    """Encodes foxglove.FrameTransforms: one transform per link, all of one time.

    Args:
        parent_frames: (L) name of each link's parent frame.
        child_frames: (L) name of each link's own frame.
    """

    def __init__(self, parent_frames: Sequence[str], child_frames: Sequence[str]) -> None:
        message = FrameTransforms()
        for link, (parent, child) in enumerate(zip(parent_frames, child_frames, strict=True)):
            transform = message.transforms.add(parent_frame_id=parent, child_frame_id=child)
            _set_placeholder(transform.timestamp)
            x, y, z, qw, qx, qy, qz = (_double_placeholder(7 * link + i) for i in range(7))
            transform.translation.x, transform.translation.y, transform.translation.z = x, y, z
            transform.rotation.w, transform.rotation.x = qw, qx
            transform.rotation.y, transform.rotation.z = qy, qz
        self._n_links = len(child_frames)
        self._template = _Template(message, 7 * self._n_links, self._n_links)

    def encode(
        self, times_ns: ArrayLike, translations: ArrayLike, quats_wxyz: ArrayLike
    ) -> NDArray[np.uint8]:
        """One serialised message per time.

        Args:
            times_ns: (T,) int64, ns since the epoch, not negative.
            translations: (T, L, 3) of each link's frame in its parent's, m.
            quats_wxyz: (T, L, 4) likewise, unit, wxyz.

        Returns:
            (T, size) uint8; each row is one message.

        Raises:
            ValueError: the shapes do not fit each other or the links, or a time is negative.
        """
        positions = np.asarray(translations, dtype=np.float64)
        quats = np.asarray(quats_wxyz, dtype=np.float64)
        n_frames = len(positions)
        _require_shape("translations", positions, (n_frames, self._n_links, 3))
        _require_shape("quats_wxyz", quats, (n_frames, self._n_links, 4))
        return self._template.fill(times_ns, np.concatenate((positions, quats), axis=2))


class JointStatesTemplate:
    """Encodes foxglove.JointStates: the same fields for every joint.

    Args:
        joint_names: (J) names.
        fields: which of `position` (rad), `velocity` (rad/s), `acceleration` (rad/s^2) and `effort`
            (Nm) the messages carry, in the order in which `encode` takes them.
    """

    def __init__(self, joint_names: Sequence[str], fields: Sequence[str]) -> None:
        message = JointStates()
        _set_placeholder(message.timestamp)
        for joint, name in enumerate(joint_names):
            state = message.joints.add(name=name)
            for i, field in enumerate(fields):
                setattr(state, field, _double_placeholder(joint * len(fields) + i))
        self._n_joints, self._fields = len(joint_names), tuple(fields)
        self._template = _Template(message, self._n_joints * len(fields), n_times=1)

    def encode(self, times_ns: ArrayLike, *columns: ArrayLike) -> NDArray[np.uint8]:
        """One serialised message per time.

        Args:
            times_ns: (T,) int64, ns since the epoch, not negative.
            columns: (T, J) each, one per field, in the order given at construction.

        Returns:
            (T, size) uint8; each row is one message.

        Raises:
            ValueError: columns are missing or do not fit the joints, or a time is negative.
        """
        if len(columns) != len(self._fields):
            raise ValueError(f"{len(columns)} columns for the fields {', '.join(self._fields)}")
        values = np.stack([np.asarray(c, dtype=np.float64) for c in columns], axis=-1)
        _require_shape("columns", values, (len(values), self._n_joints, len(self._fields)))
        return self._template.fill(times_ns, values)


class _Template:
    """One serialised message, and where its doubles and its timestamps are."""

    def __init__(self, message: Message, n_doubles: int, n_times: int) -> None:
        data: bytes = message.SerializeToString()
        self._bytes = np.frombuffer(data, dtype=np.uint8)
        self._doubles = np.concatenate(
            [_find(data, _double_placeholder_bytes(i), 1) for i in range(n_doubles)]
        )
        timestamp_placeholder = _timestamp_bytes(
            np.array([_SECONDS_PLACEHOLDER]), np.array([_NANOS_PLACEHOLDER])
        ).tobytes()
        self._timestamps = _find(data, timestamp_placeholder, n_times)

    def fill(self, times_ns: ArrayLike, values: NDArray[np.float64]) -> NDArray[np.uint8]:
        """(T, size) copies of the message, each with its time and its row of (T, ...) doubles."""
        times = np.asarray(times_ns, dtype=np.int64)
        _require_shape("times_ns", times, (len(values),))
        if np.any(times < 0):
            raise ValueError(f"a time is negative: {times.min()} ns")
        rows = np.empty((len(values), len(self._bytes)), dtype=np.uint8)
        rows[:] = self._bytes
        _windows(rows, "<f8")[:, self._doubles] = values.reshape(len(values), len(self._doubles))
        packed = _timestamp_bytes(*np.divmod(times, _NS_PER_S)).view(f"V{_TIMESTAMP_SIZE}")
        _windows(rows, f"V{_TIMESTAMP_SIZE}")[:, self._timestamps] = packed
        return rows


def _windows(rows: NDArray[np.uint8], dtype: str) -> NDArray[Any]:
    """(T, size) bytes as (T, size - itemsize + 1) unaligned items, one from every byte on."""
    item = np.dtype(dtype)
    n_rows, size = rows.shape
    shape = (n_rows, size - item.itemsize + 1)
    windows: NDArray[Any] = np.ndarray(shape, item, buffer=rows.data, strides=(size, 1))
    return windows


def _timestamp_bytes(seconds: NDArray[np.int64], nanos: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(T, 12): the body of a google.protobuf.Timestamp, both varints padded to five bytes."""
    packed = np.empty((len(seconds), _TIMESTAMP_SIZE), dtype=np.uint8)
    for start, tag, numbers in ((0, _SECONDS_TAG, seconds), (6, _NANOS_TAG, nanos)):
        packed[:, start] = tag
        for i in range(5):
            more = 0x80 if i < 4 else 0
            packed[:, start + 1 + i] = (numbers >> 7 * i) & 0x7F | more
    return packed


def _set_placeholder(timestamp: Timestamp) -> None:
    timestamp.seconds, timestamp.nanos = _SECONDS_PLACEHOLDER, _NANOS_PLACEHOLDER


def _double_placeholder_bytes(index: int) -> bytes:
    return _DOUBLE_PLACEHOLDER.pack(b"\xff\xfe", index, b"\xe0\x7f")


def _double_placeholder(index: int) -> float:
    (placeholder,) = struct.unpack("<d", _double_placeholder_bytes(index))
    return float(placeholder)


def _find(data: bytes, placeholder: bytes, count: int) -> NDArray[np.intp]:
    """The offsets of a placeholder, `count` of them."""
    offsets = []
    offset = data.find(placeholder)
    while offset >= 0:
        offsets.append(offset)
        offset = data.find(placeholder, offset + len(placeholder))
    if len(offsets) != count:
        raise ValueError(f"{len(offsets)} of {count} placeholders found in the serialised message")
    return np.array(offsets, dtype=np.intp)


def _require_shape(name: str, array: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
