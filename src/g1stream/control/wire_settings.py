"""Settings that depend on the receiver: a simulator, a robot, or the robot's own controller."""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.control.command import HAND_BACK_TIME, MOVED, WEIGHT_TIME
from g1stream.errors import ConfigError
from g1stream.network import is_local_only, network_name
from g1stream.robot.joints import select_joints

if TYPE_CHECKING:
    from g1stream.config import Config, StreamConfig

__all__ = ["for_wire"]


def for_wire(config: Config) -> Config:
    """The settings for the receiver of commands.

    Raises:
        ConfigError: the profile is `simulator` on a network where there may be a robot, or a
            setting is not possible with `stream.via` = arm_sdk.
    """
    if config.profile == "simulator" and not is_local_only(config.dds.interface):
        raise ConfigError(
            f"The profile simulator is refused on {network_name(config.dds.interface)}, where "
            "there may be a robot: its limits are those of a simulation.",
            "Use --profile robot; or --profile network-simulator, if a simulator is on that "
            "network and no robot can be reached.",
        )
    if config.stream.via == "arm_sdk":
        config = config.model_copy(update={"stream": _for_arm_sdk(config.stream)})
    return config


def _for_arm_sdk(settings: StreamConfig) -> StreamConfig:
    """Fill the settings of a stream that depend on `via` = arm_sdk.

    Raises:
        ConfigError: a setting is not possible through the robot's own controller.
    """
    if (select_joints(settings.played_joints) & ~MOVED).any():
        raise ConfigError(
            f"stream.joints = {settings.joints!r} selects joints of the legs, which stream.via = "
            "arm_sdk cannot move.",
            "Select joints of arms and waist, or remove --via.",
        )
    if settings.others == "free":
        raise ConfigError(
            "stream.others = free is not possible with stream.via = arm_sdk, because nothing would "
            "carry these joints.",
            "Remove --others; the other joints of arms and waist then hold their pose.",
        )
    if settings.support:
        raise ConfigError(
            f"stream.support = {settings.support} is not possible with stream.via = arm_sdk, "
            "because the robot's own controller carries the robot.",
            "Remove --support.",
        )
    return settings.model_copy(
        update={
            "ramp": max(settings.ramp, WEIGHT_TIME),
            "damp": HAND_BACK_TIME,
            "soft_start": 0.0,
        }
    )
