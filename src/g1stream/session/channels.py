"""What is in a session file: its channels, their schemas and encodings.

The samples of the wire are kept as the bytes they were (CDR, described by ROS 2 message text), and
beside them, in messages that viewers know, what is derived from them to be looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from g1stream.dds import topics
from g1stream.session.derived_channels import DERIVED_CHANNELS, Channel
from g1stream.session.schemas import ros2_name, ros2msg

if TYPE_CHECKING:
    from g1stream.dds.topics import Topic

__all__ = ["CHANNELS", "Channel"]


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


_WIRE_CHANNELS: Final = (
    _wire("/lowcmd", topics.LOWCMD, "commands to the motors, as on the wire"),
    _wire("/lowstate", topics.LOWSTATE, "state of motors and IMU, as on the wire"),
    _wire(
        "/sportmodestate", topics.SPORTMODESTATE, "base as the simulator knows it, as on the wire"
    ),
    _wire("/secondary_imu", topics.SECONDARY_IMU, "IMU in the torso, as on the wire"),
    _wire("/reference", topics.REFERENCE, "what the motion asks for, stamped as its command"),
)

CHANNELS: Final[Mapping[str, Channel]] = MappingProxyType(
    {channel.topic: channel for channel in (*DERIVED_CHANNELS, *_WIRE_CHANNELS)}
)
"""Every channel a session file can have, by its topic."""
