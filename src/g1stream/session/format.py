"""The format of a session file: channels with their schemas and encodings, and metadata.

DDS samples are kept byte for byte as CDR, with ROS 2 message text as schema, because ROS 2 has the
same plain CDR on the wire. Messages for viewers are derived from them. DDS is only loaded when the
schema of a DDS type is built, because `convert` does not need it.

Metadata are JSON values in MCAP's map of strings. Strings are stored unchanged, so that every MCAP
tool shows them plainly. Other values are encoded as JSON. A string that could be read as JSON
(`0.10`, `true`) is quoted, so that it is read back as a string.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from g1stream.dds.layout import CDR_HEADER, members
from g1stream.optional import extension
from g1stream.types import Ints, Phase

if TYPE_CHECKING:
    import numpy as np
    from google.protobuf.message import Message
    from numpy.typing import NDArray

__all__ = [
    "CHANNELS",
    "CHANNEL_OF",
    "ERROR_FIELDS",
    "METADATA_NAME",
    "TIMING_FIELDS",
    "Channel",
    "MessageBatch",
    "encode_log",
    "encode_string",
    "metadata_from_strings",
    "metadata_to_strings",
]

ERROR_FIELDS: Final = ("position", "velocity")
"""Fields of /tracking_error/*, the first ones of a foxglove.JointState after its name."""

TIMING_FIELDS: Final = ("interval_ms", "latency_ms")
"""Fields of /timing/*: longest interval between publish times, and longest latency to log time."""

#: Fields with ns since the epoch, which are one uint64 on the wire and in the schema two words, the
#: lower one first. No double holds such a number, so PlotJuggler would refuse the whole file.
_STAMPS: Final = ("state_published", "state_received")

METADATA_NAME: Final = "g1stream"
"""The name of the first metadata record. Later ones end in `.2`, `.3` and so on.

A later record's values replace an earlier's. Tools treat a repeated name as an error.
"""


class MessageBatch(NamedTuple):
    """T messages of one topic, oldest first.

    Attributes:
        topic: topic in the file.
        payloads: the messages, or (T, size) uint8 with a message in each row.
        log_times, publish_times: (T,) int64, ns since the epoch.
    """

    topic: str
    payloads: Sequence[bytes] | NDArray[np.uint8]
    log_times: Ints
    publish_times: Ints


#: Keep last, reliable, transient local and automatic liveliness as numbers of rmw/types.h, as
#: rosbag2 before version 9 writes them. Durations of 0 are unspecified.
_LATCHED_QOS: Final = json.dumps(
    [
        {
            "history": 1,
            "depth": 1,
            "reliability": 1,
            "durability": 1,
            "deadline": {"sec": 0, "nsec": 0},
            "lifespan": {"sec": 0, "nsec": 0},
            "liveliness": 1,
            "liveliness_lease_duration": {"sec": 0, "nsec": 0},
            "avoid_ros_namespace_conventions": False,
        }
    ]
)


@dataclass(frozen=True)
class Channel:
    """A channel of a session file.

    Attributes:
        topic: topic in the file.
        schema_name: such as `foxglove.Log` or `unitree_hg/msg/LowCmd`.
        schema_encoding, message_encoding: MCAP's well-known names.
        description: one line for people who inspect the file.
        build_schema: makes the schema's data.
        dds_topic: DDS topic whose samples it holds, bit for bit; None for derived channels.
        latched: published once; later subscribers still need its message.
        grown: if its type has grown, bytes of a message before, where those that were added begin,
            and their number.
    """

    topic: str
    schema_name: str
    schema_encoding: str
    message_encoding: str
    description: str
    build_schema: Callable[[], bytes] = field(repr=False)
    dds_topic: str | None = None
    latched: bool = False
    grown: tuple[int, int, int] = (0, 0, 0)

    @property
    def metadata(self) -> dict[str, str]:
        """The channel's metadata in the file."""
        qos = self.offered_qos_profiles
        return {"description": self.description} | ({"offered_qos_profiles": qos} if qos else {})

    @property
    def offered_qos_profiles(self) -> str:
        """The QoS for playback with rosbag2, in YAML; empty for rosbag2's default."""
        return _LATCHED_QOS if self.latched else ""


def _description(topic: str, what: str) -> Channel:
    # ROS's own message type, from which viewers read a URDF.
    name = "std_msgs/msg/String"
    return Channel(topic, name, "ros2msg", "cdr", what, lambda: b"string data\n", latched=True)


def _foxglove(
    topic: str, message_class: type[Message], description: str, *, latched: bool = False
) -> Channel:
    name = message_class.DESCRIPTOR.full_name
    build = partial(_protobuf_schema, message_class)
    return Channel(topic, name, "protobuf", "protobuf", description, build, latched=latched)


def _dds(dds_topic: str, name: str, description: str) -> Channel:
    topic = f"/{dds_topic.rpartition('/')[2]}"
    build = partial(_ros2_schema, dds_topic)
    return Channel(topic, name, "ros2msg", "cdr", description, build, dds_topic)


def _tracking_error(topic: str, description: str) -> Channel:
    build = partial(_protobuf_schema, JointStates, n_fields=len(ERROR_FIELDS))
    return replace(_foxglove(topic, JointStates, description), build_schema=build)


def _protobuf_schema(message_class: type[Message], n_fields: int | None = None) -> bytes:
    """A serialised FileDescriptorSet of a message and its imports, with the imports first.

    With `n_fields`, a joint has no more optional fields than these, because PlotJuggler draws every
    field of the schema, and those that are not set as zeros.
    """
    from mcap_protobuf.schema import build_file_descriptor_set  # imports mcap's writer: 30 ms

    files = build_file_descriptor_set(message_class)
    for message in (message for file in files.file for message in file.message_type):
        if message.name == "JointState" and n_fields is not None:
            del message.field[1 + n_fields :]  # the first one is the name
            del message.oneof_decl[n_fields:]  # one for each optional field
    schema: bytes = files.SerializeToString()
    return schema


def _ros2_schema(dds_topic: str) -> bytes:
    """The type of a DDS topic as ROS 2 message text, followed by its nested types."""
    from g1stream.dds.messages import TOPICS

    idl_type = next(topic.idl_type for topic in TOPICS if topic.name == dds_topic)
    nested = (
        f"{'=' * 80}\nMSG: {_ros2_type(struct)}\n{_ros2_fields(struct)}"
        for struct in _nested_structs(idl_type)
    )
    return (_ros2_fields(idl_type) + "".join(nested)).encode()


def _ros2_fields(idl_type: Any) -> str:
    lines = []
    for name, (element, length) in members(idl_type).items():
        if name == "phase":  # viewers show constants before a field as names of its values
            lines += [f"uint8 {phase.name}={phase.value}\n" for phase in Phase]
        size = "" if length is None else f"[{length}]"
        kind = "uint32[2]" if name in _STAMPS else f"{_ros2_type(element)}{size}"
        lines.append(f"{kind} {name}\n")
    return "".join(lines)


def _ros2_type(element: Any) -> str:
    """A ROS 2 type name: `uint8`, or `unitree_hg/IMUState` for `unitree_hg.msg.dds_.IMUState_`."""
    if isinstance(element, str):
        return "uint8" if element == "byte" else element
    parts = element.__idl_typename__.split(".")
    return f"{parts[0]}/{parts[-1].removesuffix('_')}"


def _nested_structs(idl_type: Any) -> list[Any]:
    """The struct types nested in a type, without duplicates, in the order of their use."""
    found: dict[str, Any] = {}
    for element, _ in members(idl_type).values():
        if not isinstance(element, str):
            for struct in (element, *_nested_structs(element)):
                found.setdefault(struct.__idl_typename__, struct)
    return list(found.values())


def _timing(topic: str, description: str) -> Channel:
    schema = "".join(f"float64 {name}\n" for name in TIMING_FIELDS).encode()
    return Channel(topic, "g1stream/msg/Timing", "ros2msg", "cdr", description, lambda: schema)


def _policy(topic: str, description: str) -> Channel:
    def build() -> bytes:
        schema: bytes = extension("policy_terms_schema")()
        return schema

    return Channel(topic, "g1stream/msg/PolicyTerms", "ros2msg", "cdr", description, build)


_ALL: Final = (
    _foxglove("/tf", FrameTransforms, "reference pose of every link, from world down the tree"),
    _foxglove("/measured/tf", FrameTransforms, "measured pose of every link, frames measured/*"),
    _foxglove(
        "/ghost/tf", FrameTransforms, "reference joints on the measured pelvis, frames ghost/*"
    ),
    _foxglove("/reference/joint_states", JointStates, "joints of the reference"),
    _foxglove("/measured/joint_states", JointStates, "joints as the motors report them"),
    _foxglove(
        "/simulated/joint_states",
        JointStates,
        "joints of a simulated robot with the recorded commands",
    ),
    _tracking_error("/tracking_error/joint_states", "reference minus measured, at each LowState"),
    _tracking_error("/tracking_error/limbs", "RMS of the tracking error over each limb's joints"),
    _timing("/timing/commands", "longest interval and latency of commands, by spans of 0.05 s"),
    _timing("/timing/states", "longest interval and latency of LowStates, by spans of 0.05 s"),
    _foxglove("/log", Log, "phase changes, safety events, gaps and overruns"),
    _foxglove(
        "/scene",
        SceneUpdate,
        "shapes of the reference, locked to the frames of its links",
        latched=True,
    ),
    _foxglove("/measured/scene", SceneUpdate, "shapes of the measured robot", latched=True),
    _foxglove("/ghost/scene", SceneUpdate, "shapes of the ghost, translucent", latched=True),
    _foxglove("/measured/path", SceneUpdate, "path of the measured pelvis in the last seconds"),
    _description("/robot_description", "the robot's URDF"),
    _description("/measured/robot_description", "a URDF with the frames of the measured robot"),
    _dds("rt/lowcmd", "unitree_hg/msg/LowCmd", "commands to the motors"),
    _dds("rt/arm_sdk", "unitree_hg/msg/LowCmd", "targets for arms and waist"),
    _dds("rt/lowstate", "unitree_hg/msg/LowState", "state of motors and IMU"),
    _dds("rt/sportmodestate", "unitree_go/msg/SportModeState", "base from the simulator"),
    _dds("rt/odommodestate", "unitree_go/msg/SportModeState", "base as the robot estimates it"),
    replace(
        _dds("rt/g1stream/policy", "g1stream/msg/Policy", "steps of a learned policy"),
        grown=(4276, 4160, 4096),  # in 0.1 it had room for 1024 observed values
    ),
    _policy("/policy/terms", "/policy by the names of terms and joints, with delays in ms"),
    _dds("rt/secondary_imu", "unitree_hg/msg/IMUState", "IMU in the torso"),
    _dds(
        "rt/g1stream/reference",
        "g1stream/msg/Reference",
        "target of the motion, with the publish time of its LowCmd",
    ),
)

CHANNELS: Final[Mapping[str, Channel]] = MappingProxyType({one.topic: one for one in _ALL})
"""Every channel that a session file can have, by topic."""

CHANNEL_OF: Final = {one.dds_topic: one.topic for one in _ALL if one.dds_topic}
"""Topic in the file for each DDS topic whose samples are kept byte for byte."""


def encode_string(text: str) -> bytes:
    """Encode a std_msgs/String in CDR."""
    data = text.encode() + b"\0"
    return CDR_HEADER + len(data).to_bytes(4, "little") + data


def encode_log(time_ns: int, level: int, name: str, text: str) -> bytes:
    """Encode what a program logs as a foxglove.Log; the time in ns since the epoch.

    The level is 1 debug, 2 info, 3 warning, 4 error or 5 fatal.
    """
    message = Log(level=cast("Log.Level.ValueType", level), name=name, message=text)
    message.timestamp.FromNanoseconds(time_ns)
    data: bytes = message.SerializeToString()
    return data


def metadata_to_strings(values: Mapping[str, Any]) -> dict[str, str]:
    """Convert values to strings for MCAP.

    Raises:
        TypeError: a value is neither JSON nor a numpy array or scalar.
    """
    return {key: _to_string(value) for key, value in values.items()}


def metadata_from_strings(strings: Mapping[str, str]) -> dict[str, Any]:
    """Convert strings of `metadata_to_strings` back to values."""
    return {key: _from_string(string) for key, string in strings.items()}


def _to_string(value: Any) -> str:
    if isinstance(value, str) and _from_string(value) is value:
        return value
    return json.dumps(value, default=_from_numpy)


def _from_string(string: str) -> Any:
    try:
        return json.loads(string)
    except (ValueError, RecursionError):  # not JSON, or nested too deeply to be ours
        return string


def _from_numpy(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")
