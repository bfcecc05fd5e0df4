"""The left-right symmetry of a G1: which joint mirrors which, and with which sign."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.errors import RobotError
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.rotations import quat_rotate
from g1stream.robot.urdf import KEPT_ROBOTS
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.robot.model import G1

__all__ = ["MIRROR", "JointMirror", "mirror_of_joints", "other_side"]

MIRROR: Final = np.array([1.0, -1.0, 1.0])
"""The reflection across the plane between left and right, x to the front and z up."""
MIRROR.setflags(write=False)

#: Axes of mirrored joints are parallel: the cosine between them is at least this.
_PARALLEL: Final = 0.999


class JointMirror(NamedTuple):
    """Mirrored angles are `sign * joint_pos[..., joint]`.

    Attributes:
        joint: (29,) the joint on the other side, or the same one in the middle.
        sign: (29,) 1 or -1.
    """

    joint: NDArray[np.intp]
    sign: Floats


def other_side(name: str) -> str:
    """The name of a joint or link on the other side; the same name in the middle."""
    for side, other in (("left_", "right_"), ("right_", "left_")):
        if name.startswith(side):
            return other + name.removeprefix(side)
    return name


@lru_cache(maxsize=KEPT_ROBOTS)
def mirror_of_joints(robot: G1) -> JointMirror:
    """Which joint mirrors which, from the axes of the joints where all angles are zero.

    The reflection M of a turn by t about the axis a is the turn by t about -M a, as an axis is a
    pseudovector. The joint on the other side turns about b; so the sign is that of -M a . b.

    Raises:
        RobotError: axes of a left and a right joint do not mirror each other.
    """
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    quat = forward_kinematics(robot, np.zeros((1, len(robot.joint_names))), np.zeros(3), upright)[1]
    links = [
        int(np.flatnonzero(robot.joint_of_link == j)[0]) for j in range(len(robot.joint_names))
    ]
    axes = quat_rotate(quat[0, links], robot.axis[links])
    joint = np.array([robot.joint_names.index(other_side(name)) for name in robot.joint_names])
    cosine = -np.sum(MIRROR * axes * axes[joint], axis=-1)
    worst = int(np.abs(cosine).argmin())
    if abs(cosine[worst]) < _PARALLEL:
        raise RobotError(
            f"The robot {robot.name!r} cannot be mirrored: {robot.joint_names[worst]} and "
            f"{robot.joint_names[joint[worst]]} do not turn about axes that mirror each other.",
            "Give the URDF of a robot with a left and a right side alike.",
        )
    return JointMirror(joint, np.sign(cosine))
