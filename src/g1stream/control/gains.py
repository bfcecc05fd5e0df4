"""Servo gains by joint, from the table in a config; pure."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from g1stream.errors import ConfigError
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from g1stream.config import GainsConfig

__all__ = ["Gains", "resolve_gains"]


class Gains(NamedTuple):
    """kp (29,) Nm/rad and kd (29,) Nm s/rad, motor order."""

    kp: NDArray[np.float64]
    kd: NDArray[np.float64]


def resolve_gains(config: GainsConfig) -> Gains:
    """Put a config's patterns over the gains of Unitree's example.

    Raises:
        ConfigError: a pattern that fits no joint.
    """
    return Gains(_resolved("kp", EXAMPLE_KP, config.kp), _resolved("kd", EXAMPLE_KD, config.kd))


def _resolved(
    which: str, default: NDArray[np.float64], table: Mapping[str, float]
) -> NDArray[np.float64]:
    gains: NDArray[np.float64] = default.copy()
    for pattern, value in table.items():
        fits = [i for i, name in enumerate(JOINT_NAMES) if fnmatchcase(name, pattern)]
        if not fits:
            raise ConfigError(
                f"The gain gains.{which}.{pattern!r} fits no joint.",
                f"Use a joint's name or a pattern, such as *_knee_joint; the joints are "
                f"{', '.join(JOINT_NAMES)}.",
            )
        gains[fits] = value
    return gains
