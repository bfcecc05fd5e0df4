"""The 29 joints of a G1: names, limbs, motors and example gains, in motor order.

Motor order is the order of the motors in LowCmd and LowState. All arrays are read-only. G1s with
fewer joints have the same order without the missing motors, see `JOINT_SETS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from g1stream.types import Floats

N = TypeVar("N", int, float)

__all__ = [
    "AB_JOINTS",
    "ARMATURE",
    "DAMPING",
    "EXAMPLE_KD",
    "EXAMPLE_KP",
    "FRICTION",
    "JOINT_GROUPS",
    "JOINT_NAMES",
    "JOINT_SETS",
    "LEGS",
    "MIRRORED_JOINT",
    "MIRROR_SIGN",
    "N_JOINTS",
    "TORQUE_LIMIT",
    "JointSet",
    "by_joint",
    "matching_joints",
    "select_joints",
]

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
"""Joint names as in the URDF; the index is the motor's index on the wire."""

N_JOINTS: Final = len(JOINT_NAMES)

JOINT_GROUPS: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType(
    {
        group: tuple(JOINT_NAMES.index(name) for name in names)
        for group, names in _NAMES_BY_GROUP.items()
    }
)
"""Limb name to the motor indices of that limb; together the groups hold each joint once."""

LEGS: Final = len(JOINT_GROUPS["left_leg"]) + len(JOINT_GROUPS["right_leg"])
"""Number of leg joints, which are the first ones."""

AB_JOINTS: Final = tuple(
    JOINT_NAMES.index(f"{name}_joint")
    for part in ("left_ankle", "right_ankle", "waist")
    for name in (f"{part}_pitch", f"{part}_roll")
)
"""Indices of ankles and waist, whose slots are the motors A and B, not pitch and roll, where
mode_pr is 1."""

_OTHER_SIDE: Final = {"left": "right", "right": "left"}
MIRRORED_JOINT: Final = np.array(
    [
        JOINT_NAMES.index(f"{_OTHER_SIDE.get(side, side)}_{joint}")
        for side, _, joint in (name.partition("_") for name in JOINT_NAMES)
    ]
)
"""(29,) index of the joint on the other side; for a joint of the waist, its own index."""

MIRROR_SIGN: Final = np.array(
    [-1.0 if "_roll_" in name or "_yaw_" in name else 1.0 for name in JOINT_NAMES]
)
"""(29,) signs of a mirrored pose, `MIRROR_SIGN * joint_pos[..., MIRRORED_JOINT]`. An axis is a
pseudovector, so rotations about x and z change their sign, and those about y do not."""


def matching_joints(pattern: str, where: str) -> list[int]:
    """Motor indices of a limb, both arms or legs, a joint, or a pattern of joints.

    Args:
        pattern: a name or pattern, such as `left_arm`, `arms`, `waist_yaw`, `*_knee_joint`. The
            ending `_joint` can be omitted.
        where: source of the pattern for the error, such as `In stream.joints`.

    Raises:
        ConfigError: the pattern matches no joint.
    """
    limbs = [limb for limb in JOINT_GROUPS if pattern in (limb, f"{limb.rpartition('_')[2]}s")]
    found = [joint for limb in limbs for joint in JOINT_GROUPS[limb]]
    found = found or [
        i
        for i, name in enumerate(JOINT_NAMES)
        if fnmatchcase(name, pattern) or fnmatchcase(name.removesuffix("_joint"), pattern)
    ]
    if not found:
        close = get_close_matches(pattern, (*JOINT_GROUPS, "arms", "legs", *JOINT_NAMES))
        raise ConfigError(
            f"{where}: {pattern!r} matches no joint.",
            f"Close matches: {', '.join(close)}."
            if close
            else f"Use {', '.join(JOINT_GROUPS)}, arms, legs, a joint such as left_knee, or a "
            "pattern such as *_knee. docs/glossary.md lists the joints.",
        )
    return found


def select_joints(selection: str | None) -> NDArray[np.bool_]:
    """(29,) the joints that `stream.joints` selects; all if None.

    Raises:
        ConfigError: a part of the selection matches no joint.
    """
    chosen = np.full(N_JOINTS, selection is None)
    for pattern in (selection or "").split(",") if selection is not None else ():
        chosen[matching_joints(pattern.strip(), f"In stream.joints = {selection!r}")] = True
    return chosen


@dataclass(frozen=True)
class JointSet:
    """The joints of one kind of G1.

    Attributes:
        name: name of the kind.
        mode_machine: value of mode_machine in its LowState.
        absent: motor indices of the missing joints. In LowCmd and LowState all values of their
            motors are 0, including the mode.
    """

    name: str
    mode_machine: int
    absent: tuple[int, ...]

    @property
    def present(self) -> NDArray[np.bool_]:
        """(29,) the joints that it has."""
        return np.isin(np.arange(N_JOINTS), self.absent, invert=True)

    def allowed(self, modes: Sequence[int]) -> tuple[int, ...]:
        """`safety.mode_machine` for this kind, whose value replaces that of the 29-joint G1."""
        return tuple(
            self.mode_machine if mode == JOINT_SETS[0].mode_machine else mode for mode in modes
        )

    def __str__(self) -> str:
        return f"{self.name}, {N_JOINTS - len(self.absent)} joints"

    @classmethod
    def of_mode(cls, mode_machine: int) -> JointSet | None:
        """The kind of G1 with this mode_machine in its LowState; None if there is none."""
        return next((one for one in JOINT_SETS if one.mode_machine == mode_machine), None)


def _absent(*patterns: str) -> tuple[int, ...]:
    return tuple(sorted(j for one in patterns for j in matching_joints(one, "JOINT_SETS")))


JOINT_SETS: Final = (
    JointSet("g1_29dof_rev_1_0", 5, ()),
    JointSet(
        "g1_23dof",
        4,
        _absent(
            *("waist_roll_joint", "waist_pitch_joint", "*_wrist_pitch_joint", "*_wrist_yaw_joint")
        ),
    ),
    JointSet("g1_29dof_lock_waist", 6, _absent("waist_roll_joint", "waist_pitch_joint")),
    JointSet("g1_dual_arm", 9, _absent("legs", "waist")),
)
"""The kinds of G1; the first one has all 29 joints."""


def by_joint(values: Sequence[N]) -> dict[str, N]:
    """Map joint names to the nonzero ones of (29,) values, highest first."""
    counted = [(name, n) for name, n in zip(JOINT_NAMES, values, strict=True) if n]
    return dict(sorted(counted, key=lambda one: -one[1]))


def _per_joint(leg: Sequence[float], waist: Sequence[float], arm: Sequence[float]) -> Floats:
    values = np.array([*leg, *leg, *waist, *arm, *arm], dtype=np.float64)
    values.setflags(write=False)
    return values


EXAMPLE_KP: Final = _per_joint((60, 60, 60, 100, 40, 40), (60, 40, 40), (40,) * 7)
"""Stiffness (29,) of Unitree's G1 low-level example, N·m/rad."""

EXAMPLE_KD: Final = _per_joint((1, 1, 1, 2, 1, 1), (1,) * 3, (1,) * 7)
"""Damping (29,) of Unitree's G1 low-level example, N·m·s/rad."""

# Parameters of the motors and gearboxes. The values are from unitree_mujoco's model of the G1;
# Unitree has not published those of the robot.

TORQUE_LIMIT: Final = _per_joint(
    (88, 88, 88, 139, 50, 50), (88, 50, 50), (25, 25, 25, 25, 25, 5, 5)
)
"""Maximum motor torque (29,) in either direction, N·m; the efforts in the URDF differ."""

ARMATURE: Final = _per_joint((0.01,) * 6, (0.01,) * 3, (0.01,) * 7)
"""Inertia of the rotor (29,), reflected to the joint, kg·m²."""

DAMPING: Final = _per_joint((0.05,) * 6, (0.05,) * 3, (0.05,) * 7)
"""Viscous friction (29,), N·m·s/rad."""

FRICTION: Final = _per_joint((0.2,) * 6, (0.2,) * 3, (0.2,) * 5 + (0.1,) * 2)
"""Dry friction (29,), N·m; lower in the small motors of wrist pitch and yaw."""
