"""ROS 2's messages: their definitions, what they are in CDR, and their topics and types on DDS.

On DDS a topic of ROS has the prefix `rt`, and the type of `tf2_msgs/msg/TFMessage` is called
`tf2_msgs::msg::dds_::TFMessage_` (https://design.ros2.org/articles/topic_and_service_names.html).
Nothing here loads DDS until a type is asked for, as `convert` needs none.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.dds.layout import CDR_HEADER
from g1stream.types import Ints

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "JOINT_STATES",
    "ROBOT_DESCRIPTION",
    "TF",
    "Cdr",
    "CdrReader",
    "FramePose",
    "JointAngles",
    "Ros2Topic",
    "decode_joint_state",
    "decode_tf",
    "encode_joint_state",
    "encode_string",
    "encode_tf",
    "message_text",
]

_NS_PER_S: Final = 1_000_000_000

_DEFINITIONS: Final = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/String": "string data\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    ),
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\n"
        "float64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    ),
    "rcl_interfaces/Log": (
        "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n"
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n"
        "string file\nstring function\nuint32 line\n"
    ),
}
"""ROS's message definitions, each after those that it is made of."""


@dataclass(frozen=True)
class Ros2Topic:
    """A topic of ROS 2 on DDS.

    Attributes:
        name: on DDS.
        definition: of its message, such as `std_msgs/String`.
        depth: how many messages a publisher of ROS keeps for slow subscribers.
        latched: the last message is kept for subscribers that come later, too.
    """

    name: str
    definition: str
    depth: int
    latched: bool = False

    @property
    def idl_type(self) -> Any:
        """The cyclonedds class that names the type on DDS."""
        return _idl_type(self.definition)


# With the depths of tf2_ros' TransformBroadcaster, joint_state_publisher, robot_state_publisher.
TF: Final = Ros2Topic("rt/tf", "tf2_msgs/TFMessage", depth=100)
JOINT_STATES: Final = Ros2Topic("rt/joint_states", "sensor_msgs/JointState", depth=10)
ROBOT_DESCRIPTION: Final = Ros2Topic(
    "rt/robot_description", "std_msgs/String", depth=1, latched=True
)


@cache
def _idl_type(definition: str) -> Any:
    """The cyclonedds class of a message."""
    from cyclonedds.idl.types import sequence

    from g1stream.dds import types

    package, _, name = definition.partition("/")
    fields = {}
    for line in _DEFINITIONS[definition].splitlines():
        kind, field = line.split()
        element = kind.removesuffix("[]")
        if element == "string":
            idl_type: Any = str
        elif element in _DEFINITIONS:
            idl_type = _idl_type(element)
        else:
            idl_type = getattr(types, element)
        fields[field] = sequence[idl_type] if kind.endswith("[]") else idl_type
    return types.idl_struct(f"{package}.msg.dds_.{name}_", **fields)


def message_text(definition: str) -> bytes:
    """The definition of a message and of all that it is made of, as ROS 2 message text."""
    nested = (f"{'=' * 80}\nMSG: {one}\n{_DEFINITIONS[one]}" for one in _nested(definition))
    return (_DEFINITIONS[definition] + "".join(nested)).encode()


def _nested(definition: str) -> list[str]:
    """The messages that a message is made of, the one that is used first before the others."""
    used = [line.split()[0].removesuffix("[]") for line in _DEFINITIONS[definition].splitlines()]
    names = [n for one in used if one in _DEFINITIONS for n in (one, *_nested(one))]
    return list(dict.fromkeys(names))


class Cdr:
    """Writes little-endian CDR: each number at a multiple of its own size.

    Args:
        data: what comes before, CDR header included.
    """

    def __init__(self, data: bytes = CDR_HEADER) -> None:
        self.data = bytearray(data)

    def numbers(self, kind: str, *values: float) -> None:
        """Write numbers of one kind, a character of `struct`."""
        self.data += bytes((len(CDR_HEADER) - len(self.data)) % struct.calcsize(kind))
        self.data += struct.pack(f"<{len(values)}{kind}", *values)

    def string(self, text: str) -> None:
        data = text.encode() + b"\0"
        self.numbers("I", len(data))
        self.data += data

    def doubles(self, values: Sequence[float]) -> None:
        """Write a sequence of doubles, which may be empty."""
        self.numbers("I", len(values))
        if values:
            self.numbers("d", *values)

    def time(self, time_ns: int) -> None:
        """Write a builtin_interfaces/Time: ns since the epoch."""
        self.numbers("I", *divmod(time_ns, _NS_PER_S))


class CdrReader:
    """Reads CDR: each number at a multiple of its own size, after the header.

    Args:
        data: a message, CDR header included.

    Raises:
        ValueError: the data is no plain CDR, or ends too early; also from every method.
    """

    def __init__(self, data: bytes) -> None:
        if len(data) < len(CDR_HEADER) or data[0] != 0 or data[1] > 1:
            raise ValueError("it is no plain CDR")
        self._order = "<" if data[1] else ">"
        self._data, self._at = memoryview(data)[len(CDR_HEADER) :], 0

    def numbers(self, kind: str, n: int = 1) -> tuple[Any, ...]:
        """Numbers of one kind, a character of `struct`; of none not even the padding is there."""
        if n == 0:
            return ()
        size = struct.calcsize(kind)
        start = self._at + -self._at % size
        self._at = start + n * size
        if self._at > len(self._data):
            raise ValueError("it ends too early")
        return struct.unpack_from(f"{self._order}{n}{kind}", self._data, start)

    def length(self) -> int:
        """The length of a sequence, each element of which takes a byte or more."""
        (n,) = self.numbers("I")
        if n > len(self._data) - self._at:
            raise ValueError("it ends too early")
        return int(n)

    def string(self) -> str:
        """A string, without the zero at its end."""
        n = self.length()
        self._at += n
        return bytes(self._data[self._at - n : self._at]).rstrip(b"\0").decode()

    def time(self) -> int:
        """A builtin_interfaces/Time: ns since the epoch."""
        (seconds,), (nanoseconds,) = self.numbers("i"), self.numbers("I")
        return int(seconds * _NS_PER_S + nanoseconds)


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


def decode_joint_state(data: bytes) -> JointAngles:
    """The angles in a sensor_msgs/JointState in CDR.

    Raises:
        ValueError: it is none.
    """
    cdr = CdrReader(data)
    stamp = cdr.time()
    cdr.string()
    names = tuple(cdr.string() for _ in range(cdr.length()))
    return JointAngles(stamp, names, cdr.numbers("d", cdr.length()))


def decode_tf(data: bytes) -> list[FramePose]:
    """The transforms in a tf2_msgs/TFMessage in CDR.

    Raises:
        ValueError: it is none.
    """
    cdr, poses = CdrReader(data), []
    for _ in range(cdr.length()):
        stamp, parent, child = cdr.time(), cdr.string(), cdr.string()
        x, y, z, qx, qy, qz, qw = cdr.numbers("d", 7)
        poses.append(FramePose(stamp, parent, child, (x, y, z), (qw, qx, qy, qz)))
    return poses


def encode_string(text: str) -> bytes:
    """A std_msgs/String in CDR."""
    cdr = Cdr()
    cdr.string(text)
    return bytes(cdr.data)


def encode_joint_state(
    time_ns: int,
    names: Sequence[str],
    position: Sequence[float],
    velocity: Sequence[float],
    effort: Sequence[float],
) -> bytes:
    """A sensor_msgs/JointState in CDR.

    Args:
        time_ns: of the stamp, since the epoch.
        names: of J joints.
        position: (J) rad; like the other two, empty where it is not known.
        velocity: (J) rad/s.
        effort: (J) N·m.
    """
    cdr = Cdr(_joint_names(tuple(names)))
    struct.pack_into("<2I", cdr.data, len(CDR_HEADER), *divmod(time_ns, _NS_PER_S))
    for values in (position, velocity, effort):
        cdr.doubles(values)
    return bytes(cdr.data)


@cache
def _joint_names(names: tuple[str, ...]) -> bytes:
    """A JointState up to its names, with a stamp of 0."""
    cdr = Cdr()
    cdr.time(0)
    cdr.string("")
    cdr.numbers("I", len(names))
    for name in names:
        cdr.string(name)
    return bytes(cdr.data)


def encode_tf(
    times_ns: ArrayLike,
    parents: Sequence[str],
    children: Sequence[str],
    translations: ArrayLike,
    quats_wxyz: ArrayLike,
) -> bytes:
    """A tf2_msgs/TFMessage of N transforms in CDR.

    Args:
        times_ns: of the stamps, (N) since the epoch, or one for all.
        parents: (N) names of the frames in which the poses are given.
        children: (N) names of the frames whose poses they are.
        translations: (N, 3) m.
        quats_wxyz: (N, 4) unit quaternions.
    """
    template, stamps, poses = _tf_template(tuple(parents), tuple(children))
    data = bytearray(template)
    words = np.frombuffer(data, "<u4")
    words[stamps], words[stamps + 1] = np.divmod(np.asarray(times_ns, np.int64), _NS_PER_S)
    start = len(CDR_HEADER)
    doubles = np.frombuffer(data, "<f8", (len(data) - start) // 8, start)
    quats = np.reshape(quats_wxyz, (-1, 4))[:, [1, 2, 3, 0]]
    doubles[poses] = np.concatenate([np.reshape(translations, (-1, 3)), quats], axis=1)
    return bytes(data)


@cache
def _tf_template(parents: tuple[str, ...], children: tuple[str, ...]) -> tuple[bytes, Ints, Ints]:
    """A TFMessage of zeros, and where the numbers belong.

    Returns:
        The message; (N) which of its 32-bit words are the seconds, with the nanoseconds after them;
        (N, 7) which of the doubles after its header are translation and rotation, xyzw.
    """
    cdr, stamps, poses = Cdr(), [], []
    cdr.numbers("I", len(children))
    for parent, child in zip(parents, children, strict=True):
        cdr.time(0)
        stamps.append(len(cdr.data) // 4 - 2)
        cdr.string(parent)
        cdr.string(child)
        cdr.numbers("d", *[0.0] * 7)
        poses.append((len(cdr.data) - len(CDR_HEADER)) // 8 - 7)
    places = np.array(poses, np.intp)[:, np.newaxis] + np.arange(7)
    return bytes(cdr.data), np.array(stamps, np.intp), places
