"""The 29 joints of a G1, in the order of the motors in LowCmd and LowState."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

__all__ = ["EXAMPLE_KD", "EXAMPLE_KP", "JOINT_GROUPS", "JOINT_NAMES", "N_JOINTS", "by_joint"]

_LEG: Final = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_WAIST: Final = ("waist_yaw", "waist_roll", "waist_pitch")
_ARM: Final = (
    "shoulder_pitch",
    "shoulder_roll",
    "shoulder_yaw",
    "elbow",
    "wrist_roll",
    "wrist_pitch",
    "wrist_yaw",
)

_NAMES_BY_GROUP: Final = {
    "left_leg": tuple(f"left_{part}_joint" for part in _LEG),
    "right_leg": tuple(f"right_{part}_joint" for part in _LEG),
    "waist": tuple(f"{part}_joint" for part in _WAIST),
    "left_arm": tuple(f"left_{part}_joint" for part in _ARM),
    "right_arm": tuple(f"right_{part}_joint" for part in _ARM),
}

JOINT_NAMES: Final[tuple[str, ...]] = tuple(
    name for names in _NAMES_BY_GROUP.values() for name in names
)
"""Joint names as the URDF has them; the index is the motor's index on the wire."""

N_JOINTS: Final = len(JOINT_NAMES)

JOINT_GROUPS: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(
    {
        group: tuple(JOINT_NAMES.index(name) for name in names)
        for group, names in _NAMES_BY_GROUP.items()
    }
)
"""Limb name to the motor indices of that limb; together the groups hold each joint once."""


def by_joint(ticks: Sequence[int]) -> dict[str, int]:
    """Joint -> ticks, of (29,), the joints with most first, without those that have none."""
    counted = [(name, n) for name, n in zip(JOINT_NAMES, ticks, strict=True) if n]
    return dict(sorted(counted, key=lambda one: -one[1]))


def _gains(
    leg: Sequence[float], waist: Sequence[float], arm: Sequence[float]
) -> NDArray[np.float64]:
    gains = np.array([*leg, *leg, *waist, *arm, *arm], dtype=np.float64)
    gains.setflags(write=False)
    return gains


EXAMPLE_KP: Final[NDArray[np.float64]] = _gains(
    leg=(60, 60, 60, 100, 40, 40), waist=(60, 40, 40), arm=(40,) * len(_ARM)
)
"""Stiffness (29,) of Unitree's G1 low-level example, N·m/rad."""

EXAMPLE_KD: Final[NDArray[np.float64]] = _gains(
    leg=(1, 1, 1, 2, 1, 1), waist=(1, 1, 1), arm=(1,) * len(_ARM)
)
"""Damping (29,) of Unitree's G1 low-level example, N·m·s/rad."""
