"""What a stream can combine: source, receiver, robot and settings. combinations.toml lists it."""

from __future__ import annotations

import sys
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from g1stream.errors import ConfigError, SafetyError
from g1stream.network import network_name
from g1stream.robot.joints import select_joints

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from g1stream.config import Config
    from g1stream.robot.model import G1

__all__ = ["combinations", "require_combination"]

#: Keys of a table that are not settings of a stream.
_ABOUT = {"what", "kinds", "network", "lockstep", "dds", "gains"}


@cache
def combinations() -> dict[str, dict[str, dict[str, Any]]]:
    """The tables of combinations.toml, by source and receiver."""
    text = resources.files(__package__).joinpath("combinations.toml").read_text(encoding="utf-8")
    found: dict[str, dict[str, dict[str, Any]]] = tomllib.loads(text)
    return found


def require_combination(config: Config, robot: G1, *, simulated: bool) -> None:
    """Refuse what combinations.toml does not list.

    Args:
        config: all settings.
        robot: the robot.
        simulated: only a simulator can be reached.

    Raises:
        ConfigError: a setting is not possible with the source and the receiver.
        SafetyError: the source may not be used where there may be a robot.
    """
    settings = config.stream
    source = "policy" if settings.policy else "motion"
    if settings.support == "feet" and not settings.policy:
        source = "feet"
    receivers = combinations()[source]
    named = {"policy": "--policy", "feet": "--support feet", "motion": "a motion"}[source]
    if settings.via not in receivers:
        raise ConfigError(
            f"stream.via = {settings.via} is not possible with {named}.",
            f"Use {', '.join(receivers)}.",
        )
    row = receivers[settings.via]
    if source == "motion":
        named = f"stream.via = {settings.via}"
    if not (simulated or config.profile == "network-simulator" or row["network"]):
        raise SafetyError(
            f"{named} is not allowed on {network_name(config.dds.interface)}: it was only tried "
            "in simulators, and a robot that falls breaks.",
            "Use the loopback interface; or --profile network-simulator, if a simulator is on that "
            "network and no robot can be reached.",
        )
    for name in sorted(row.keys() - _ABOUT):
        value, allowed = getattr(settings, name), row[name]
        if value == type(settings).model_fields[name].default or value in allowed:
            continue
        if name == "joints" and allowed:
            outside = select_joints(value) & ~select_joints(allowed[0])
            if not outside.any():
                continue
        given = " or ".join(str(one).lower() for one in allowed)
        raise ConfigError(
            f"stream.{name} = {value} is not possible with {named}.",
            f"Remove it, or use {given}." if given else "Remove it.",
        )
    if robot.joint_set.name not in row["kinds"]:
        raise ConfigError(
            f"A robot of the kind {robot.joint_set} is not possible with {named}.",
            f"Use a robot with the joints of {' or '.join(row['kinds'])}.",
        )
    if not row.get("gains", True) and (config.gains.kp or config.gains.kd):
        raise ConfigError(
            f"Gains are not possible with {named}, which has its own.",
            "Remove --gains and [gains].",
        )
