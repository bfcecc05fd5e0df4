"""What each joint's motor and gearbox add to the mechanics of the links, in motor order.

The figures are those of unitree_mujoco's model of the G1; the robot's own are not published. All
arrays are read-only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.joints import JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["ARMATURE", "DAMPING", "FRICTION", "TORQUE_LIMIT"]

_N = len(JOINT_NAMES)
_LEG: Final = (88, 88, 88, 139, 50, 50)
_WAIST: Final = (88, 50, 50)
_ARM: Final = (25, 25, 25, 25, 25, 5, 5)


def _per_motor(values: Sequence[float]) -> NDArray[np.float64]:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


TORQUE_LIMIT: Final = _per_motor([*_LEG, *_LEG, *_WAIST, *_ARM, *_ARM])
"""Greatest torque (29,) either way, N·m; the URDF's efforts differ."""

ARMATURE: Final = _per_motor([0.01] * _N)
"""Inertia (29,) of the rotor as the joint feels it, kg·m²."""

DAMPING: Final = _per_motor([0.05] * _N)
"""Viscous friction (29,), N·m·s/rad."""

FRICTION: Final = _per_motor(
    [
        0.1 if name.endswith(("wrist_pitch_joint", "wrist_yaw_joint")) else 0.2
        for name in JOINT_NAMES
    ]
)
"""Dry friction (29,), N·m; less in the wrists' small motors."""
