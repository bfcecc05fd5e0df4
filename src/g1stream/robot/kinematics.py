"""Forward kinematics of many frames at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from g1stream.robot.rotations import quat_mul, quat_rotate
from g1stream.types import Floats

if TYPE_CHECKING:
    from g1stream.robot.model import G1


__all__ = ["LinkPoses", "forward_kinematics", "local_transforms"]


class LinkPoses(NamedTuple):
    """Poses of T frames by L links, in the order of `G1.link_names`.

    Attributes:
        pos: (T, L, 3) m, origin of the link's frame.
        quat_wxyz: (T, L, 4) unit quaternions.
    """

    pos: Floats
    quat_wxyz: Floats


def local_transforms(
    robot: G1, joint_pos: Floats, root_pos: Floats, root_quat_wxyz: Floats
) -> LinkPoses:
    """Each link's pose relative to its parent link; the root's relative to the world.

    Args:
        robot: the robot.
        joint_pos: (T, 29) rad, motor order.
        root_pos: (T, 3) m, or (3,) for all frames.
        root_quat_wxyz: (T, 4) unit quaternions, or (4,) for all frames.

    Returns:
        Poses of shape (T, L, ...); quaternion signs are continuous where the inputs are.

    Raises:
        ValueError: `joint_pos` is not (T, 29), or the root arrays do not fit its T.
    """
    n_joints = len(robot.joint_names)
    if joint_pos.ndim != 2 or joint_pos.shape[1] != n_joints:
        raise ValueError(f"joint_pos must have the shape (T, {n_joints}), not {joint_pos.shape}")
    n_frames = len(joint_pos)

    # With q the origin's quaternion and a the joint's axis, a rotation by t gives
    # cos(t/2) q + sin(t/2) q (0, a): two constants per link instead of a product per frame.
    moving = robot.joint_of_link >= 0
    half = joint_pos[:, robot.joint_of_link[moving], None] / 2
    origin, axis = robot.origin_quat_wxyz[moving], robot.axis[moving]
    turned = quat_mul(origin, np.concatenate([np.zeros((len(axis), 1)), axis], axis=1))
    quat = np.repeat(robot.origin_quat_wxyz[None], n_frames, axis=0)
    quat[:, moving] = np.cos(half) * origin + np.sin(half) * turned
    pos = np.repeat(robot.origin_pos[None], n_frames, axis=0)
    pos[:, 0], quat[:, 0] = root_pos, root_quat_wxyz
    return LinkPoses(pos, quat)


def forward_kinematics(
    robot: G1, joint_pos: Floats, root_pos: Floats, root_quat_wxyz: Floats
) -> LinkPoses:
    """Each link's pose in the world.

    Arguments, shapes and errors are those of `local_transforms`.
    """
    pos, quat = local_transforms(robot, joint_pos, root_pos, root_quat_wxyz)
    for links in robot.levels:
        up = robot.parent[links]
        pos[:, links] = pos[:, up] + quat_rotate(quat[:, up], pos[:, links])
        quat[:, links] = quat_mul(quat[:, up], quat[:, links])
    return LinkPoses(pos, quat)
