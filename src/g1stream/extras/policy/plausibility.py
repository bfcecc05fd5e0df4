"""Whether gains, scales and default pose of a policy can be those of a G1.

Its motors left and right are alike, and so are their gains in all published policies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from g1stream.errors import ConfigError
from g1stream.extras.policy.families import TABLE
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, MIRRORED_JOINT, N_JOINTS
from g1stream.robot.model import G1
from g1stream.text import listed
from g1stream.types import Floats

__all__ = ["ORDERS", "doubts", "refuse_implausible"]

_DEPTH: Final = {
    JOINT_NAMES[joint]: depth + len(JOINT_GROUPS["waist"]) * group.endswith("arm")
    for group, joints in JOINT_GROUPS.items()
    for depth, joint in enumerate(joints)
}
ORDERS: Final[Mapping[str, Sequence[str]]] = {
    "motor order": JOINT_NAMES,
    "Isaac's order": sorted(JOINT_NAMES, key=_DEPTH.__getitem__),
    "alphabetical order": sorted(JOINT_NAMES),
}
"""The 29 joints in the orders that files have; Isaac's is breadth first."""

#: Values left and right that differ by a smaller share are rounded.
_EQUAL: Final = 0.05
#: Values that differ by less, in their units, are rounded, too.
_NOISE: Final = 1e-3
#: Whether a motor has another one on the other side, (29,).
_IN_PAIRS: Final = np.arange(N_JOINTS) != MIRRORED_JOINT
#: Least pairs of joints, not 0, that show the order of values. A pose with fewer may be uneven.
_PAIRS: Final = 3
#: Least torque of a servo whose target is the whole range of its joint away, as a share of the
#: torque limit. Published policies have 0.3 (ankle roll) and more; kp = 1 has 0.01 there.
_REACH: Final = 0.05
#: Torque that an action of 1 asks for, as a share of the limit; 0.16 to 3.4 in published policies.
_UNIT: Final = 0.05, 10.0


def refuse_implausible(
    values: Mapping[str, Any], names: Sequence[str], robot: G1, where: str
) -> None:
    """Refuse what no policy of a G1 has.

    Args:
        values: `default_pos`, `kp`, `kd` and `action_scale`, each (joints,).
        names: the joints.
        robot: the robot.
        where: the policy, for the error.

    Raises:
        ConfigError: a servo is too weak for its joint or does not damp it, gains or scales differ
            left and right, or the default pose is symmetric in another order of the joints.
    """
    kp, kd = (_by_motor(values[what], names) for what in ("kp", "kd"))
    reach = kp * (robot.upper - robot.lower)
    weak = np.flatnonzero((reach < _REACH * robot.torque_limit) | (kd <= 0.0))
    if len(weak):
        at = weak[0]
        raise ConfigError(
            f"In {where}, {JOINT_NAMES[at]} has kp {kp[at]:g} and kd {kd[at]:g}: with the target a "
            f"whole range of the joint away, the servo has {reach[at]:.2g} of the motor's "
            f"{robot.torque_limit[at]:g} N·m{', and does not damp' if kd[at] <= 0.0 else ''}.",
            "Write kp and kd of the training to the TOML file beside it. Exporters write 1 and 0 "
            "where the training computes torques itself.",
        )
    for what in ("kp", "kd", "action_scale", "default_pos"):
        given = _by_motor(np.abs(values[what]), names)
        if not len(uneven := _uneven(given)):
            continue
        there = {
            order: _by_motor(np.abs(values[what]), [name for name in of if name in names])
            for order, of in ORDERS.items()
        }
        even = [
            order
            for order, of in there.items()
            if not len(_uneven(of)) and np.sum((of > _NOISE) & _IN_PAIRS) >= 2 * _PAIRS
        ]
        if what == "default_pos" and not even:  # a pose may be uneven
            continue
        at, other = uneven[0], MIRRORED_JOINT[uneven[0]]
        raise ConfigError(
            f"In {where}, {what} of {JOINT_NAMES[at]} is {given[at]:g} and of {JOINT_NAMES[other]} "
            f"{given[other]:g}, although the motors are alike: the values are "
            + (f"in {listed(even)}, not in that of the joints." if even else "in another order."),
            f"Write joint_names or {what} of the training to the TOML file beside it.",
        )


def doubts(values: Mapping[str, Any], names: Sequence[str], robot: G1) -> list[str]:
    """What is unusual in values as of `refuse_implausible`, in sentences."""
    kp, scale, pose = (
        _by_motor(np.abs(values[what]), names) for what in ("kp", "action_scale", "default_pos")
    )
    asked = kp * scale / robot.torque_limit
    classes = _by_motor([_kp_of_class(name) for name in names], names)
    other = np.flatnonzero(np.abs(kp / classes - 1.0) > _EQUAL)
    if len(other) > 0.5 * len(names):  # the training has other gains
        other = other[:0]
    told = [
        f"|default_pos| of {JOINT_NAMES[at]} is {pose[at]:g} rad, on the other side "
        f"{pose[MIRRORED_JOINT[at]]:g}"
        for at in _uneven(pose)[:1]
    ]
    told += [
        f"an action of 1 asks {JOINT_NAMES[at]} for {asked[at]:.2g} times its torque limit: kp or "
        "action_scale may be that of another joint"
        for at in np.flatnonzero((asked < _UNIT[0]) | (asked > _UNIT[1]))[:1]
    ]
    told += [
        f"kp of {JOINT_NAMES[at]} is {kp[at]:g} N·m/rad, but its motor class has "
        f"{classes[at]:g}; {len(names) - len(other)} other joints have the value of theirs"
        for at in other[:1]
    ]
    return told


def _by_motor(values: Sequence[float], names: Sequence[str]) -> Floats:
    """Values of some joints in motor order (29,); NaN for the others."""
    ordered = np.full(N_JOINTS, np.nan)
    ordered[[JOINT_NAMES.index(name) for name in names]] = values
    return ordered


def _uneven(values: Floats) -> NDArray[np.intp]:
    """Motors whose value (29,) is not that of the other side."""
    other = values[MIRRORED_JOINT]
    return np.flatnonzero(
        np.abs(values - other) > np.maximum(_NOISE, _EQUAL * np.maximum(values, other))
    )


def _kp_of_class(name: str) -> float:
    fitting = [kp for pattern, kp in TABLE["motor_classes"].items() if fnmatchcase(name, pattern)]
    return float(fitting[-1])
