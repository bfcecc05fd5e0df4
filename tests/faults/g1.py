"""The joints of a G1 in motor order, from Unitree's g1_29dof.urdf, and those of rt/arm_sdk."""

from __future__ import annotations

from typing import Final

import numpy as np

_LEG: Final = {  # lower and upper limit, rad; effort, N·m; velocity, rad/s
    "hip_pitch": (-2.5307, 2.8798, 88, 32),
    "hip_roll": (-0.5236, 2.9671, 88, 20),
    "hip_yaw": (-2.7576, 2.7576, 88, 32),
    "knee": (-0.0873, 2.8798, 139, 20),
    "ankle_pitch": (-0.8727, 0.5236, 50, 30),
    "ankle_roll": (-0.2618, 0.2618, 50, 30),
}
_WAIST: Final = {
    "waist_yaw": (-2.618, 2.618, 88, 32),
    "waist_roll": (-0.52, 0.52, 50, 30),
    "waist_pitch": (-0.52, 0.52, 50, 30),
}
_ARM: Final = {
    "shoulder_pitch": (-3.0892, 2.6704, 25, 37),
    "shoulder_roll": (-1.5882, 2.2515, 25, 37),
    "shoulder_yaw": (-2.618, 2.618, 25, 37),
    "elbow": (-1.0472, 2.0944, 25, 37),
    "wrist_roll": (-1.9723, 1.9723, 25, 37),
    "wrist_pitch": (-1.6145, 1.6145, 5, 22),
    "wrist_yaw": (-1.6145, 1.6145, 5, 22),
}


def _mirrored(name: str, row: tuple[float, ...]) -> tuple[float, ...]:
    lower, upper, *rest = row
    return (-upper, -lower, *rest) if name.endswith("_roll") else row


_ROWS: Final = (
    {f"left_{name}": row for name, row in _LEG.items()}
    | {f"right_{name}": _mirrored(name, row) for name, row in _LEG.items()}
    | _WAIST
    | {f"left_{name}": row for name, row in _ARM.items()}
    | {f"right_{name}": _mirrored(name, row) for name, row in _ARM.items()}
)
JOINTS: Final = tuple(f"{name}_joint" for name in _ROWS)
#: The joints that rt/arm_sdk moves, and the slot whose q is the weight.
ARMS, WEIGHT = slice(JOINTS.index("waist_yaw_joint"), len(JOINTS)), len(JOINTS)
LOWER, UPPER, EFFORT, VELOCITY = np.array(list(_ROWS.values()), float).T
