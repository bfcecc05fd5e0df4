"""Servo gains by joint, from the tables of a config or a gains file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, matching_joints
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from g1stream.config import GainsConfig

__all__ = ["Gains", "read_gains", "resolve_gains"]

_FORMAT: Final = (
    'Write tables [kp] and [kd] of joint names or patterns, such as "*_knee_joint" = 150.0.'
)


class Gains(NamedTuple):
    """kp (29,) N·m/rad and kd (29,) N·m·s/rad, motor order."""

    kp: Floats
    kd: Floats


def resolve_gains(config: GainsConfig, where: str = "[gains] of the config") -> Gains:
    """The gains of Unitree's example, changed by the tables of a config.

    Args:
        config: joints, limbs or patterns and their gains; later entries override earlier ones.
        where: the source of the gains, for the error.

    Raises:
        ConfigError: a name or pattern matches no joint.
    """
    return Gains(
        _resolved(EXAMPLE_KP, config.kp, f"{where}, kp"),
        _resolved(EXAMPLE_KD, config.kd, f"{where}, kd"),
    )


def _resolved(default: Floats, table: Mapping[str, float], where: str) -> Floats:
    gains: Floats = default.copy()
    for pattern, value in table.items():
        gains[matching_joints(pattern, f"In {where}")] = value
    return gains


def read_gains(path: Path) -> dict[str, Any]:
    """Read the tables of a gains file, which override those of a config.

    Raises:
        ConfigError: the file cannot be read, a name matches no joint or a value is not a gain.
    """
    from g1stream.config import GainsConfig, read_table

    gains, tables = read_table(GainsConfig, path, "gains file", _FORMAT)
    resolve_gains(gains, f"the gains file {path}")
    return tables
