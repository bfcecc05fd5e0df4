"""A file of servo gains, which goes over the config's."""

from __future__ import annotations

from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

__all__ = ["read_gains"]

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
    for name, table in (("kp", gains.kp), ("kd", gains.kd)):
        _require_joints(path, name, table)
    return tables


def _require_joints(path: Path, table: str, patterns: Iterable[str]) -> None:
    from g1stream.robot.joints import JOINT_NAMES

    for pattern in patterns:
        if any(fnmatchcase(name, pattern) for name in JOINT_NAMES):
            continue
        alike = get_close_matches(pattern, JOINT_NAMES, _ALIKE)
        names = f"Of the {len(JOINT_NAMES)} joints, these are alike: {', '.join(alike)}."
        raise ConfigError(
            f"In the gains file {path}, {table}.{pattern!r} fits no joint.",
            names
            if alike
            else f"Use one of the {len(JOINT_NAMES)} joints' names, such as {JOINT_NAMES[0]}, or a "
            "pattern, such as *_knee_joint; `g1stream motion demo --json` lists them.",
        )
