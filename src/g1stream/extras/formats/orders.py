"""The order of joints in files without joint names, and the evidence for it."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args

import numpy as np

from g1stream.robot.joints import JOINT_NAMES, JOINT_SETS, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1, REVISIONS
from g1stream.robot.rotations import quat_normalize
from g1stream.types import JointOrder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.types import Floats

__all__ = [
    "MAY_LACK",
    "WRISTS",
    "Order",
    "in_motor_order",
    "layouts",
    "names_in_order",
    "order_by_bodies",
    "order_by_limits",
    "order_by_links",
    "set_of",
    "share_beyond_limits",
    "some_frames",
    "told_by_limits",
]

WRISTS: Final = tuple(name for name in JOINT_NAMES if "_wrist_" in name)
"""The joints that files of 23 joints lack most often."""
_G1_23DOF: Final = JOINT_SETS[1]
MAY_LACK: Final = {*WRISTS, *(JOINT_NAMES[i] for i in _G1_23DOF.absent)}
"""Joints that a motion may lack, because a retargeting tool or a kind of G1 lacks them."""
#: Number of frames that are used to compare bodies.
_FRAMES: Final = 50
#: Bodies decide the joint order if its links are within this distance of them, mm, and within
#: this fraction of the distance in the other order.
_NEAR: Final = 50.0
_NEARER: Final = 0.5
#: Limits decide the joint order if the other order has more than this fraction of the angles
#: beyond them, and more than this multiple.
_BEYOND: Final = 1e-2
_TIMES: Final = 10.0
#: The same fraction for two sets of 23 joints in motor order, which differ in waist and arms only.
_ARMS: Final = 1e-3
#: An angle counts as beyond a limit if it is so far beyond it, rad; retargeting tools exceed
#: limits by as much.
_EXCESS: Final = 0.02


class Order(NamedTuple):
    """The joint in each column, and the evidence for it.

    Attributes:
        other: a likely other order, if joint limits are weak evidence against it; otherwise "".
        assumed: there is no evidence.
    """

    columns: tuple[str, ...]
    why: str
    other: str = ""
    assumed: bool = False


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


def some_frames(n_frames: int, at_most: int = 5000) -> NDArray[np.intp]:
    """Indices of frames, evenly spaced."""
    return np.linspace(0, n_frames - 1, min(at_most, n_frames)).astype(np.intp)


def order_by_bodies(
    angles: Floats, bodies: NDArray[Any], root_pos: Floats, root_quat_wxyz: Floats
) -> Order | None:
    """The order in which forward kinematics puts the links at the bodies; None if none does.

    Args:
        angles: (T, n) rad, n of `layouts`.
        bodies: (T, B, 3) positions of bodies in the world frame, m.
        root_pos: (T, 3) position of the pelvis, m.
        root_quat_wxyz: (T, 4) its orientation, of any length above 0.
    """
    names, few = layouts(angles.shape[1]), some_frames(len(angles), _FRAMES)
    pose = root_pos[few], root_quat_wxyz[few]
    near = {
        order: _distance(in_motor_order(angles[few], joints), bodies[few], *pose)
        for order, joints in names.items()
    }
    best, other, *_ = sorted(names, key=lambda order: near[order])
    # The pelvis alone is equally near in both orders. A distance is NaN if a quaternion is zero.
    if not near[best][0] < min(_NEAR, _NEARER * near[other][0]):
        return None
    return Order(
        names[best],
        f"{best}{set_of(names[best])}: bodies are {near[best][0]:.1f} mm from the links of "
        f"{near[best][1]}, in {other} order {near[other][0]:.0f} mm",
    )


def order_by_links(links: Sequence[str], n_joints: int) -> Order | None:
    """The order of a list of links, as MuJoCo and Isaac Lab number joints like their links.

    Args:
        links: names of the links or bodies of a robot.
        n_joints: number of joints in the file.

    Returns:
        The order; None if the list does not have the links of so many joints.
    """
    robot = G1.default()
    joint_of = dict(zip(robot.link_names, robot.joint_of_link.tolist(), strict=True))
    names = tuple(JOINT_NAMES[i] for link in links if (i := joint_of.get(link, -1)) >= 0)
    known = next((order for order, of in layouts(len(names)).items() if of == names), "")
    if len(names) != n_joints or not known:
        return None
    return Order(names, f"{known}{set_of(names)}, that of the links in the file")


def told_by_limits(beyond: Sequence[float]) -> bool:
    """Whether joint limits tell the first of some readings from the others.

    Args:
        beyond: the share of angles beyond the limits in each, the smallest one first.
    """
    return all(one > max(_BEYOND, _TIMES * beyond[0]) for one in beyond[1:])


def order_by_limits(angles: Floats, robot: G1 | None, *, motor_assumed: bool) -> Order | str:
    """The order with the fewest angles beyond the joint limits.

    If two sets of 23 joints fit equally, the robot's is assumed, or the one without wrists.

    Args:
        angles: (T, n) rad, n of `layouts`.
        robot: the robot that plays the motion.
        motor_assumed: assume motor order if it and Isaac Lab's fit.

    Returns:
        The order; why it is ambiguous if it is.
    """
    names, few = layouts(angles.shape[1]), some_frames(len(angles))
    beyond = {order: share_beyond_limits(angles[few], joints) for order, joints in names.items()}
    own = robot and tuple(JOINT_NAMES[joint] for joint in np.flatnonzero(robot.present))
    ranked = sorted(names, key=lambda order: (beyond[order], names[order] != own))
    best = ranked[0]
    fits = [
        order
        for order in ranked
        if beyond[order]
        <= max(_BEYOND if "isaaclab" in (best, order) else _ARMS, _TIMES * beyond[best])
    ]
    assumed = len(fits) > 1
    if assumed and "isaaclab" in fits:
        if not motor_assumed:
            shares = " and ".join(f"{beyond[order]:.2%} in {order} order" for order in names)
            return f"{shares} are beyond the joint limits"
        fits.remove("isaaclab")
    chosen, *rivals = fits
    other = next(order for order in (*rivals, *ranked) if order != chosen)
    return Order(
        names[chosen],
        f"{chosen}{set_of(names[chosen])}: {beyond[chosen]:.2%} of the angles are beyond the joint "
        f"limits, in {other} order {beyond[other]:.2%}",
        other if rivals or chosen != "motor" else "",
        assumed,
    )


def _distance(
    joint_pos: Floats, bodies: NDArray[Any], root_pos: Floats, root_quat_wxyz: Floats
) -> tuple[float, str]:
    """Mean distance, mm, from each body (T, B, 3) to the nearest link, for the best robot model.

    Returns:
        The distance, and the robot's name.
    """
    found, quat = bodies[:, :, np.newaxis], quat_normalize(root_quat_wxyz)
    distances = []
    for name in REVISIONS:
        links = forward_kinematics(G1.load(name), joint_pos, root_pos, quat).pos
        nearest = np.linalg.norm(found - links[:, np.newaxis], axis=-1).min(axis=-1)
        distances.append((float(nearest.mean() * 1e3), name))
    return min(distances)


def share_beyond_limits(angles: Floats, names: tuple[str, ...]) -> float:
    """The share of angles (T, n) of the joints `names` beyond their limits, with 0 for the rest."""
    robot, joint_pos = G1.default(), in_motor_order(angles, names)
    excess = np.maximum(robot.lower - joint_pos, joint_pos - robot.upper)
    return float((excess > _EXCESS).mean())
