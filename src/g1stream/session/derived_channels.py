"""The channels of a session file that are made for looking at; they need no DDS to be known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet

if TYPE_CHECKING:
    from google.protobuf.message import Message

    from g1stream.dds.topics import Topic

__all__ = ["DERIVED_CHANNELS", "Channel"]


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


def _schema(message_class: type[Message]) -> bytes:
    """A serialised FileDescriptorSet of a message and all that it imports, the imported first."""
    files: dict[str, Any] = {}
    _collect(message_class.DESCRIPTOR.file, files)
    collected = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(collected.file.add())
    schema: bytes = collected.SerializeToString()
    return schema


def _collect(file: Any, found: dict[str, Any]) -> None:
    if file.name not in found:
        for imported in file.dependencies:
            _collect(imported, found)
        found[file.name] = file


def _foxglove(topic: str, message_class: type[Message], description: str) -> Channel:
    return Channel(
        topic,
        schema_name=message_class.DESCRIPTOR.full_name,
        schema_encoding="protobuf",
        message_encoding="protobuf",
        description=description,
        build_schema=partial(_schema, message_class),
    )


# The URDF goes in ROS's own message, as that is what viewers look for under this topic.
_ROBOT_DESCRIPTION: Final = Channel(
    "/robot_description",
    schema_name="std_msgs/msg/String",
    schema_encoding="ros2msg",
    message_encoding="cdr",
    description="the robot's URDF",
    build_schema=lambda: b"string data\n",
)

DERIVED_CHANNELS: Final = (
    _foxglove("/tf", FrameTransforms, "reference pose of every link, from world down the tree"),
    _foxglove("/measured/tf", FrameTransforms, "measured pose of every link, frames measured/*"),
    _foxglove("/reference/joint_states", JointStates, "joints as the motion asks for them"),
    _foxglove("/measured/joint_states", JointStates, "joints as the motors report them"),
    _foxglove(
        "/tracking_error/joint_states", JointStates, "reference minus measured, at each LowState"
    ),
    _foxglove("/log", Log, "phase changes, safety events, gaps and overruns"),
    _foxglove("/scene", SceneUpdate, "the robot's shapes, each locked to the frame of its link"),
    _ROBOT_DESCRIPTION,
)
