"""The topics and what travels on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from g1stream.dds.messages import Log, LowCmd, LowState, Reference, SecondaryImu, SportModeState

if TYPE_CHECKING:
    from g1stream.dds.messages import Message

__all__ = [
    "ARM_SDK",
    "COMMANDS",
    "LOG",
    "LOWCMD",
    "LOWSTATE",
    "REFERENCE",
    "SECONDARY_IMU",
    "SPORTMODESTATE",
    "TOPICS",
    "Topic",
]


@dataclass(frozen=True)
class Topic:
    """A DDS topic: its name on the wire and the message it carries."""

    name: str
    message: type[Message]

    @property
    def idl_type(self) -> Any:
        """The cyclonedds class that names the type on the wire."""
        return self.message.idl_type


LOWCMD: Final = Topic("rt/lowcmd", LowCmd)
ARM_SDK: Final = Topic("rt/arm_sdk", LowCmd)
LOWSTATE: Final = Topic("rt/lowstate", LowState)
SPORTMODESTATE: Final = Topic("rt/sportmodestate", SportModeState)
SECONDARY_IMU: Final = Topic("rt/secondary_imu", SecondaryImu)
REFERENCE: Final = Topic("rt/g1stream/reference", Reference)
LOG: Final = Topic("rt/g1stream/log", Log)

COMMANDS: Final = {"lowcmd": LOWCMD, "arm_sdk": ARM_SDK}
"""Where commands go, by `stream.via`."""

TOPICS: Final = (LOWCMD, ARM_SDK, LOWSTATE, SPORTMODESTATE, SECONDARY_IMU, REFERENCE, LOG)
