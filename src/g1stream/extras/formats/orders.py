"""The orders of joints in files without joint names."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final, get_args

import numpy as np

from g1stream.robot.joints import JOINT_NAMES, JOINT_SETS, N_JOINTS
from g1stream.robot.model import G1
from g1stream.types import JointOrder

if TYPE_CHECKING:
    from g1stream.types import Floats

__all__ = ["MAY_LACK", "WRISTS", "in_motor_order", "layouts", "names_in_order", "set_of"]

WRISTS: Final = tuple(name for name in JOINT_NAMES if "_wrist_" in name)
"""The joints that files of 23 joints lack most often."""
_G1_23DOF: Final = JOINT_SETS[1]
MAY_LACK: Final = {*WRISTS, *(JOINT_NAMES[i] for i in _G1_23DOF.absent)}
"""Joints that a motion may lack, because a retargeting tool or a kind of G1 lacks them."""


@cache
def names_in_order(order: JointOrder) -> tuple[str, ...]:
    """The names of the 29 joints in an order, or of 23. Isaac Lab's is breadth first."""
    if order == "motor":
        return JOINT_NAMES
    if order == "motor-23dof":
        return tuple(JOINT_NAMES[joint] for joint in np.flatnonzero(_G1_23DOF.present))
    robot = G1.default()
    link_of = {int(joint): link for link, joint in enumerate(robot.joint_of_link) if joint >= 0}
    moving = [0] * len(robot.link_names)  # number of joints from the pelvis to a link
    for link in np.concatenate(robot.levels).tolist():
        moving[link] = moving[robot.parent[link]] + int(robot.joint_of_link[link] >= 0)
    ranked = sorted(range(N_JOINTS), key=lambda joint: (moving[link_of[joint]], joint))
    return tuple(JOINT_NAMES[joint] for joint in ranked)


def layouts(n_joints: int) -> dict[JointOrder, tuple[str, ...]]:
    """The joint in each of 29 or 23 columns without names, in the orders that they may have."""
    orders = {order: names_in_order(order) for order in get_args(JointOrder)}
    if n_joints < N_JOINTS:
        without = {o: tuple(name for name in orders[o] if name not in WRISTS) for o in orders}
        return without | {"motor-23dof": orders["motor-23dof"]}
    return {order: names for order, names in orders.items() if len(names) == n_joints}


def set_of(names: tuple[str, ...]) -> str:
    """Which of the joints these are, for messages; "" for all."""
    if len(names) == N_JOINTS:
        return ""
    wristless = not set(WRISTS).intersection(names)
    return ", without the six wrists" if wristless else f", the joints of {_G1_23DOF.name}"


def in_motor_order(angles: Floats, names: tuple[str, ...]) -> Floats:
    """(T, 29) angles of the joints `names` in motor order; 0 for the others."""
    if names == JOINT_NAMES:
        return angles
    ordered = np.zeros((len(angles), N_JOINTS))
    for joint, name in enumerate(JOINT_NAMES):
        if name in names:
            ordered[:, joint] = angles[:, names.index(name)]
    return ordered
