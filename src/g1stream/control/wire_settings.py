"""Settings that depend on the receiver: a simulator, a robot, or the robot's own controller."""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.control.receiver import load_receiver
from g1stream.errors import ConfigError
from g1stream.network import is_local_only, network_name

if TYPE_CHECKING:
    from g1stream.config import Config

__all__ = ["for_wire"]


def for_wire(config: Config) -> Config:
    """The settings for the receiver of commands.

    Raises:
        ConfigError: the profile is `simulator` on a network where there may be a robot.
    """
    if config.profile == "simulator" and not is_local_only(config.dds.interface):
        raise ConfigError(
            f"The profile simulator is refused on {network_name(config.dds.interface)}, where "
            "there may be a robot: its limits are those of a simulation.",
            "Use --profile robot; or --profile network-simulator, if a simulator is on that "
            "network and no robot can be reached.",
        )
    if config.profile == "robot":
        config = config.filled()
    stream = config.stream
    receiver = load_receiver(stream.via, stream.period, stream.damp)
    timed = stream.model_copy(update=receiver.timing(stream))
    return config.model_copy(update={"stream": timed})
