"""Settings that depend on what may be on the wire: a simulator, a robot, its own controller."""

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

#: Age of the last LowState that stops in simulation, s. There, two programs and the physics share
#: one machine, and silences above a robot's 0.1 s are common on two CPUs; nothing breaks meanwhile:
#: the torque of the feed-forward fades out after 20 ms, and the position servo holds. Half of the
#: 1 s after which Unitree's own programs stop.
_STATE_TIMEOUT_OF_SIMULATOR: Final = 0.5


def with_robot_limits(config: Config) -> Config:
    """A config in which robot.toml's values stand wherever nothing is set; unchanged on loopback.

    Its domain and interface are not taken over.
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
    """A config whose unset values that depend on the wire are set.

    On loopback there is a simulator, which may be silent for longer than a robot. Anywhere else
    there may be a robot, for which robot.toml has the values. With `stream.via` = arm_sdk, its
    topic decides on others.

    Raises:
        ConfigError: the settings ask for what is not possible with `stream.via` = arm_sdk.
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
    """The settings of a stream with `via` = arm_sdk, with those that depend on it set.

    Raises:
        ConfigError: they ask for what the robot's own controller does not let others do.
    """
    if (select_joints(settings.played_joints) & ~MOVED).any():
        raise ConfigError(
            f"stream.joints = {settings.joints!r} selects joints of the legs, which stream.via = "
            "arm_sdk cannot move.",
            "Choose of arms and waist, or leave --via out.",
        )
    if settings.others == "free":
        raise ConfigError(
            "stream.others = free with stream.via = arm_sdk: nothing would carry these joints.",
            "Leave --others out: arms and waist that do not play then hold their pose.",
        )
    if settings.support:
        raise ConfigError(
            f"stream.support = {settings.support} with stream.via = arm_sdk: the robot's own "
            "controller carries it.",
            "Leave --support out.",
        )
    return settings.model_copy(
        update={
            "ramp": max(settings.ramp, WEIGHT_TIME),
            "damp": HAND_BACK_TIME,
            "soft_start": 0.0,
        }
    )
