"""What is in a session file: its channels, their schemas and encodings.

The samples of the wire are kept as the bytes they were (CDR, described by ROS 2 message text), and
beside them, in Foxglove's own messages, what is derived from them to be looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log

from g1stream.dds import topics
from g1stream.recording.schemas import protobuf_schema, ros2_name, ros2msg

if TYPE_CHECKING:
    from google.protobuf.message import Message

    from g1stream.dds.topics import Topic

__all__ = ["CHANNELS", "Channel"]


@dataclass(frozen=True)
class Channel:
    """One channel of a session file.

    Attributes:
        topic: its name in the file.
        schema_name: such as `foxglove.Log` or `unitree_hg/msg/LowCmd`.
        schema_encoding, message_encoding: MCAP's well-known names.
        description: one line, for people who look into the file.
        build_schema: makes the schema's data.
        source: the DDS topic whose samples it holds, bit for bit; None for derived channels.
    """

    topic: str
    schema_name: str
    schema_encoding: str
    message_encoding: str
    description: str
    build_schema: Callable[[], bytes] = field(repr=False)
    source: Topic | None = None


def _foxglove(topic: str, message_class: type[Message], description: str) -> Channel:
    return Channel(
        topic,
        schema_name=message_class.DESCRIPTOR.full_name,
        schema_encoding="protobuf",
        message_encoding="protobuf",
        description=description,
        build_schema=partial(protobuf_schema, message_class),
    )


def _wire(topic: str, source: Topic, description: str) -> Channel:
    idl_type = source.message.idl_type
    return Channel(
        topic,
        schema_name=ros2_name(idl_type),
        schema_encoding="ros2msg",
        message_encoding="cdr",
        description=description,
        build_schema=lambda: ros2msg(idl_type).encode(),
        source=source,
    )


_TABLE: Final = (
    _foxglove("/tf", FrameTransforms, "reference pose of every link, from world down the tree"),
    _foxglove("/measured/tf", FrameTransforms, "measured pose of every link, frames measured/*"),
    _foxglove("/reference/joint_states", JointStates, "joints as the motion asks for them"),
    _foxglove("/measured/joint_states", JointStates, "joints as the motors report them"),
    _foxglove("/log", Log, "phase changes, safety events, gaps and overruns"),
    _wire("/lowcmd", topics.LOWCMD, "commands to the motors, as on the wire"),
    _wire("/lowstate", topics.LOWSTATE, "state of motors and IMU, as on the wire"),
    _wire(
        "/sportmodestate", topics.SPORTMODESTATE, "base as the simulator knows it, as on the wire"
    ),
    _wire("/secondary_imu", topics.SECONDARY_IMU, "IMU in the torso, as on the wire"),
    _wire("/reference", topics.REFERENCE, "what the motion asks for, stamped as its command"),
)

CHANNELS: Final[Mapping[str, Channel]] = MappingProxyType({c.topic: c for c in _TABLE})
"""Every channel a session file can have, by its topic."""
