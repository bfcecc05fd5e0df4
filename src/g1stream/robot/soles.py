"""The soles of a G1, with four corners each, like the four spheres of unitree_mujoco's feet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import RobotError
from g1stream.robot.hulls import read_hulls
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import pose_blocks
from g1stream.robot.rotations import quat_rotate

if TYPE_CHECKING:
    from g1stream.robot.kinematics import LinkPoses
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["OFF_FLOOR", "SIDES", "Soles", "bent_legs"]

SIDES: Final = ("left", "right")

OFF_FLOOR: Final = 0.002
"""Height above the floor at which a sole counts as lifted in a reference, m."""

#: Maximum height of vertices above the lowest one that belong to the lower side of a sole, m.
_FLAT: Final = 1e-3


class Soles:
    """The corners of a robot's soles, left foot first.

    The corners of a sole are in the order front left, front right, back right, back left.

    Args:
        robot: the G1.

    Attributes:
        links: (2,) links of the feet.
        corners: (2, 4, 3) corners in the frames of these links, m.
        height: height of these links above the floor when the soles are flat on it, m.

    Raises:
        RobotError: a foot of this robot has no joint, or no hull.
    """

    def __init__(self, robot: G1) -> None:
        joints = [JOINT_NAMES.index(f"{side}_ankle_roll_joint") for side in SIDES]
        if not robot.present[joints].all():
            raise RobotError(
                f"{robot.name!r} has no ankle joints.", "Use a robot with ankle joints."
            )
        self._robot = robot
        self.links = [int(np.flatnonzero(robot.joint_of_link == joint)[0]) for joint in joints]
        self.corners = np.stack([_corners(robot, robot.link_names[link]) for link in self.links])
        self.height = -float(self.corners[..., 2].min())

    def positions(self, poses: LinkPoses) -> Floats:
        """Corners (T, 8, 3) in the world, m, for link poses."""
        pos, quat = (values[:, self.links, np.newaxis] for values in poses)
        corners = pos + quat_rotate(quat, self.corners)
        return corners.reshape(len(corners), -1, 3)

    def path(self, joint_pos: Floats, root_pos: Floats, root_quat_wxyz: Floats) -> Floats:
        """Corners (T, 8, 3) in the world, m, for frames (T, 29), (T, 3) and (T, 4)."""
        path = np.empty((len(joint_pos), 8, 3))
        pose = joint_pos, root_pos, root_quat_wxyz
        for part, poses in pose_blocks(self._robot, *pose, self.links):
            path[part] = self.positions(poses)
        return path


def bent_legs(angle: float) -> Floats:
    """A pose (29,), rad, with hips and ankles bent by `angle`, and knees by twice `angle`.

    The soles are level below an upright pelvis. All other joints are at 0.
    """
    pose = np.zeros(len(JOINT_NAMES))
    for joint, turns in (("hip_pitch", -1.0), ("knee", 2.0), ("ankle_pitch", -1.0)):
        for side in SIDES:
            pose[JOINT_NAMES.index(f"{side}_{joint}_joint")] = turns * angle
    return pose


def _corners(robot: G1, link: str) -> Floats:
    """The corners (4, 3) of a foot's sole in its link's frame, m."""
    soles = [hull.vertices for hull in read_hulls(robot) if hull.solid and hull.link == link]
    if not soles:
        raise RobotError(
            f"The shape of the sole of {robot.name!r}'s {link} is unknown.",
            "Use a URDF whose feet are left_ankle_roll_link and right_ankle_roll_link.",
        )
    sole = np.concatenate(soles)
    lower = sole[sole[:, 2] < sole[:, 2].min() + _FLAT]
    outward = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])
    corners: Floats = lower[(lower[:, :2] @ outward.T).argmax(axis=0)]
    return corners
