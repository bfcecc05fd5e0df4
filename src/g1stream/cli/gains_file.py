"""A file of servo gains, which goes over the config's, and what is said of gains for no joint."""

from __future__ import annotations

from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.config import GainsConfig

__all__ = ["read_gains", "require_joints"]

_FORM: Final = (
    'Write tables [kp] and [kd] of joint names or patterns, such as "*_knee_joint" = 150.0.'
)
_ALIKE: Final = 3


def read_gains(path: Path) -> dict[str, Any]:
    """The tables of a gains file.

    Raises:
        ConfigError: it cannot be read, or something in it fits no joint or is no gain; names it.
    """
    from pydantic import ValidationError

    from g1stream.config import GainsConfig, read_toml

    try:
        tables = read_toml(path)
    except ConfigError as error:
        # As of a config, which it is not.
        raise ConfigError(error.cause.replace("The config", "The gains file", 1), _FORM) from error
    try:
        gains = GainsConfig.model_validate(tables)
    except ValidationError as error:
        first = error.errors()[0]
        where, wrong = ".".join(map(str, first["loc"])), first["msg"]
        raise ConfigError(
            f"In the gains file {path}, {where} does not fit: {wrong[0].lower()}{wrong[1:]}.", _FORM
        ) from error
    require_joints(gains, f"the gains file {path}")
    return tables


def require_joints(gains: GainsConfig, where: str) -> None:
    """Refuse a name or pattern that fits no joint, naming those that are alike.

    Raises:
        ConfigError: one fits none.
    """
    from g1stream.robot.joints import JOINT_NAMES

    for table, pattern in [*(("kp", one) for one in gains.kp), *(("kd", one) for one in gains.kd)]:
        if any(fnmatchcase(name, pattern) for name in JOINT_NAMES):
            continue
        n, alike = len(JOINT_NAMES), get_close_matches(pattern, JOINT_NAMES, _ALIKE)
        raise ConfigError(
            f"In {where}, {table}.{pattern!r} fits no joint.",
            f"Of the {n} joints, these are alike: {', '.join(alike)}."
            if alike
            else f"Use one of the {n} joints' names, such as {JOINT_NAMES[0]}, or a pattern, such "
            "as *_knee_joint.",
        )
