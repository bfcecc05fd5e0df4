"""The order of joints in arrays that do not name them, told by evidence."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args

import numpy as np

from g1stream.errors import MotionError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1, REVISIONS
from g1stream.types import JointOrder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.types import Floats

__all__ = ["Bodies", "in_motor_order", "names_in_order", "tell_order"]

#: Frames that bodies are compared in.
_FRAMES: Final = 50
#: An order is told by the bodies if it puts the links this near to them, mm, and at most at this
#: share of the distance in the other order.
_NEAR: Final = 50.0
_NEARER: Final = 0.5
#: It is told by the limits if the other has more than this share of the angles beyond them, and
#: more than so many times as many.
_BEYOND: Final = 1e-2
_TIMES: Final = 10.0
#: An angle counts as beyond a limit by more than this, rad; retargeting tools differ by as much.
_EXCESS: Final = 0.02


class Bodies(NamedTuple):
    """Positions of links in the world, whatever their order, and the pelvis's pose.

    Attributes:
        pos: (T, B, 3) m, of any floating-point type.
        root_pos: (T, 3) m.
        root_quat_wxyz: (T, 4) unit.
    """

    pos: NDArray[Any]
    root_pos: Floats
    root_quat_wxyz: Floats


@cache
def names_in_order(order: JointOrder) -> tuple[str, ...]:
    """The names of the 29 joints in an order."""
    if order == "motor":
        return JOINT_NAMES
    robot = G1.load()
    link_of = {int(joint): link for link, joint in enumerate(robot.joint_of_link) if joint >= 0}
    moving = [0] * len(robot.link_names)  # joints from the pelvis to a link
    for link in np.concatenate(robot.levels).tolist():
        moving[link] = moving[robot.parent[link]] + int(robot.joint_of_link[link] >= 0)
    ranked = sorted(range(N_JOINTS), key=lambda joint: (moving[link_of[joint]], joint))
    return tuple(JOINT_NAMES[joint] for joint in ranked)


def tell_order(angles: Floats, bodies: Bodies | None, name: str) -> tuple[JointOrder, str]:
    """In which order the joints are, and why.

    Positions of bodies decide, if there are any: forward kinematics in the right order puts the
    links where the bodies are. Otherwise the joint limits do, which the wrong order passes.

    Args:
        angles: (T, 29) rad, in an unknown order.
        bodies: where links were at the same times.
        name: of the file, for messages.

    Returns:
        The order, and a short text that says what speaks for it.

    Raises:
        MotionError: both orders are possible.
    """
    orders: tuple[JointOrder, ...] = get_args(JointOrder)
    sorted_angles = {order: in_motor_order(angles, names_in_order(order)) for order in orders}
    if bodies is not None:
        distances = {order: _distance(one, bodies) for order, one in sorted_angles.items()}
        best, other = sorted(orders, key=lambda order: distances[order])
        if distances[best].mm <= min(_NEAR, _NEARER * distances[other].mm):
            return best, (
                f"{best}: the bodies are {distances[best]}, in {other} order "
                f"{distances[other].mm:.0f} mm"
            )
    beyond = {order: _share_beyond_limits(one) for order, one in sorted_angles.items()}
    best, other = sorted(orders, key=lambda order: beyond[order])
    if beyond[other] > max(_BEYOND, _TIMES * beyond[best]):
        return best, (
            f"{best}: {beyond[best]:.2%} of the angles are beyond the joint limits, in {other} "
            f"order {beyond[other]:.2%}"
        )
    shares = " and ".join(f"{beyond[order]:.2%} in {order} order" for order in orders)
    raise MotionError(
        f"The order of the joints in {name} cannot be told: {shares} are beyond the joint limits.",
        "Say it: --joint-order motor (as LowCmd, the URDF and MuJoCo) or --joint-order isaaclab.",
    )


def in_motor_order(angles: Floats, names: Sequence[str]) -> Floats:
    """(T, 29) angles of the joints `names`, in motor order."""
    return angles[:, [names.index(name) for name in JOINT_NAMES]]


class _Distance(NamedTuple):
    """How far bodies are from the links of the robot that fits best."""

    mm: float
    robot: str

    def __str__(self) -> str:
        return f"{self.mm:.1f} mm from the links of {self.robot}"


def _distance(joint_pos: Floats, bodies: Bodies) -> _Distance:
    """Mean distance from each body to the link nearest to it."""
    few = np.linspace(0, len(joint_pos) - 1, min(_FRAMES, len(joint_pos))).astype(int)
    found = bodies.pos[few][:, :, np.newaxis]
    distances = []
    for name in REVISIONS:
        links = forward_kinematics(
            G1.load(name), joint_pos[few], bodies.root_pos[few], bodies.root_quat_wxyz[few]
        ).pos
        nearest = np.linalg.norm(found - links[:, np.newaxis], axis=-1).min(axis=-1)
        distances.append(_Distance(float(nearest.mean() * 1e3), name))
    return min(distances)


def _share_beyond_limits(joint_pos: Floats) -> float:
    robot = G1.load()
    excess = np.maximum(robot.lower - joint_pos, joint_pos - robot.upper)
    return float((excess > _EXCESS).mean())
