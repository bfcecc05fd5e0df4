"""Settings that depend on the receiver: a simulator, a robot, or the robot's own controller."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.config import SHIPPED, Config, load_config
from g1stream.control.command import HAND_BACK_TIME, MOVED, WEIGHT_TIME
from g1stream.dds.domain import is_local_only
from g1stream.errors import ConfigError
from g1stream.robot.joints import select_joints

if TYPE_CHECKING:
    from g1stream.config import StreamConfig

__all__ = ["for_wire", "with_robot_limits"]

#: Maximum age of the last LowState in simulation, s. There, two programs and the physics share one
#: machine, and silences above a robot's 0.1 s are common on two CPUs. They are harmless, because
#: the feed-forward torque fades out after 20 ms and the position servo holds. This is half of the
#: 1 s after which Unitree's own programs stop.
_STATE_TIMEOUT_OF_SIMULATOR: Final = 0.5


def with_robot_limits(config: Config) -> Config:
    """Fill unset values of a config with those of robot.toml; unchanged on loopback.

    The domain and interface of robot.toml are not used.
    """
    if is_local_only(config.dds.interface):
        return config
    robot = load_config(SHIPPED / "robot.toml")
    tables = {}
    for name in robot.model_fields_set - {"dds"}:
        given, cautious = getattr(config, name), getattr(robot, name)
        unset = {
            key: getattr(cautious, key)
            for key in cautious.model_fields_set
            if key not in given.model_fields_set or getattr(given, key) is None
        }
        tables[name] = given.model_copy(update=unset)
    return config.model_copy(update=tables)


def for_wire(config: Config) -> Config:
    """Fill unset values of a config that depend on the receiver of commands.

    On loopback the receiver is a simulator, which may be silent for longer than a robot. On other
    interfaces it may be a robot, for which robot.toml has the values. `stream.via` = arm_sdk sets
    further values.

    Raises:
        ConfigError: a setting is not possible with `stream.via` = arm_sdk.
    """
    if is_local_only(config.dds.interface):
        timeout = config.safety.state_timeout or _STATE_TIMEOUT_OF_SIMULATOR
        safety = config.safety.model_copy(update={"state_timeout": timeout})
        config = config.model_copy(update={"safety": safety})
    else:
        config = with_robot_limits(config)
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
