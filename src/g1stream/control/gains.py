"""Servo gains by joint, from the tables of a config or a gains file; pure."""

from __future__ import annotations

from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from g1stream.errors import ConfigError
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from g1stream.settings import GainsConfig

__all__ = ["Gains", "read_gains", "resolve_gains"]

_FORMAT: Final = (
    'Write tables [kp] and [kd] of joint names or patterns, such as "*_knee_joint" = 150.0.'
)


class Gains(NamedTuple):
    """kp (29,) Nm/rad and kd (29,) Nm s/rad, motor order."""

    kp: Floats
    kd: Floats


def resolve_gains(config: GainsConfig, where: str = "[gains] of the config") -> Gains:
    """The gains of Unitree's example, changed by the tables of a config.

    Args:
        config: joint names or patterns and their gains; later entries override earlier ones.
        where: named in the error.

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
        matches = [i for i, name in enumerate(JOINT_NAMES) if fnmatchcase(name, pattern)]
        if not matches:
            close = get_close_matches(pattern, JOINT_NAMES)
            raise ConfigError(
                f"In {where}: {pattern!r} matches no joint.",
                f"Close matches: {', '.join(close)}."
                if close
                else f"Use a pattern, such as *_knee_joint, or one of {', '.join(JOINT_NAMES)}.",
            )
        gains[matches] = value
    return gains


def read_gains(path: Path) -> dict[str, Any]:
    """The tables of a gains file, which override those of a config.

    Raises:
        ConfigError: the file cannot be read, a name matches no joint or a value is not a gain.
    """
    from pydantic import ValidationError

    from g1stream.config import read_toml
    from g1stream.settings import GainsConfig

    tables = read_toml(path, "gains file")
    try:
        gains = GainsConfig.model_validate(tables)
    except ValidationError as error:
        first = error.errors()[0]
        key, message = ".".join(map(str, first["loc"])), first["msg"]
        raise ConfigError(
            f"In the gains file {path}: {key} = {first['input']!r}: {message}.", _FORMAT
        ) from error
    resolve_gains(gains, f"the gains file {path}")
    return tables
