"""Forward kinematics, vectorised over frames."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.robot.rotations import quat_conj, quat_mul
from g1stream.robot.urdf import KEPT_ROBOTS
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from g1stream.robot.model import G1


__all__ = [
    "BLOCK",
    "LinkPoses",
    "LinkVelocities",
    "forward_kinematics",
    "link_velocities",
    "local_transforms",
    "pose_blocks",
]


BLOCK: Final = 1024
"""Frames per block; smaller ones are slowed by call overhead, larger ones exceed the CPU cache."""


class LinkPoses(NamedTuple):
    """Poses of T frames by L links, in the order of `G1.link_names`.

    Attributes:
        pos: (T, L, 3) m, origin of the link's frame.
        quat_wxyz: (T, L, 4) unit quaternions.
    """

    pos: Floats
    quat_wxyz: Floats


class LinkVelocities(NamedTuple):
    """Velocities of T frames by L links in the world frame, in the order of `G1.link_names`.

    Attributes:
        lin: (T, L, 3) m/s of the origin of the link's frame, or of another point of the link.
        ang: (T, L, 3) rad/s.
    """

    lin: Floats
    ang: Floats


def local_transforms(
    robot: G1, joint_pos: Floats, root_pos: Floats, root_quat_wxyz: Floats
) -> LinkPoses:
    """Compute the pose of each link relative to its parent link, and of the root in the world.

    Args:
        robot: the robot.
        joint_pos: (T, 29) rad, motor order.
        root_pos: (T, 3) m, or (3,) for all frames.
        root_quat_wxyz: (T, 4) unit quaternions, or (4,) for all frames.

    Returns:
        Poses of shape (T, L, ...); quaternion signs are continuous if those of the inputs are.

    Raises:
        ValueError: `joint_pos` is not (T, 29), or the root arrays have another T.
    """
    n_frames = _n_frames(robot, joint_pos)
    # With q the quaternion of the origin and a the axis of the joint, a rotation by t gives
    # cos(t/2) q + sin(t/2) q (0, a), with two constants per link instead of a product per frame.
    moving = robot.joint_of_link >= 0
    half = joint_pos[:, robot.joint_of_link[moving], None] / 2
    origin, turned = robot.origin_quat_wxyz[moving], _turned(robot)[moving]
    quat = np.repeat(robot.origin_quat_wxyz[None], n_frames, axis=0)
    quat[:, moving] = np.cos(half) * origin + np.sin(half) * turned
    pos = np.repeat(robot.origin_pos[None], n_frames, axis=0)
    pos[:, 0], quat[:, 0] = root_pos, root_quat_wxyz
    return LinkPoses(pos, quat)


def forward_kinematics(
    robot: G1,
    joint_pos: Floats,
    root_pos: Floats,
    root_quat_wxyz: Floats,
    links: Sequence[int] | None = None,
) -> LinkPoses:
    """Compute the pose of each link in the world; shapes and errors as of `local_transforms`.

    Args:
        robot: the robot.
        joint_pos: rad, motor order.
        root_pos: m.
        root_quat_wxyz: unit quaternions.
        links: links whose poses are computed, None: all. Other links are NaN unless they are
            between the root and one of these.
    """
    n_frames, n_links = _n_frames(robot, joint_pos), len(robot.parent)
    times, turn, _ = _matrices(robot)
    half = joint_pos.T[robot.joint_of_link, None] / 2
    half[robot.joint_of_link < 0] = 0.0
    pos, quat = np.empty((n_links, 3, n_frames)), np.empty((n_links, 4, n_frames))
    if links is not None:
        pos[:], quat[:] = np.nan, np.nan
    pos[0] = np.broadcast_to(root_pos, (n_frames, 3)).T
    quat[0] = np.broadcast_to(root_quat_wxyz, (n_frames, 4)).T
    for level in robot.levels if links is None else _levels(robot, tuple(links)):
        above, pos_above = quat[robot.parent[level]], pos[robot.parent[level]]
        pos[level] = pos_above + turn[level] @ _products(above)
        turned = times[level] @ above  # with the joint at 0 and at pi
        cos, sin = np.cos(half[level]), np.sin(half[level])
        quat[level] = cos * turned[:, :4] + sin * turned[:, 4:]
    return LinkPoses(pos.transpose(2, 0, 1), quat.transpose(2, 0, 1))


def link_velocities(
    robot: G1,
    poses: LinkPoses,
    joint_vel: Floats,
    root_lin_vel: Floats,
    root_ang_vel: Floats,
    links: Sequence[int] | None = None,
    points: Floats | None = None,
) -> LinkVelocities:
    """Compute the velocity of each link in the world, from the root outwards.

    A link rotates with its parent and about its joint, and its origin is a point of its parent.

    Args:
        robot: the robot.
        poses: poses from `forward_kinematics`.
        joint_vel: (T, 29) rad/s, motor order.
        root_lin_vel: (T, 3) m/s of the root's origin, world frame.
        root_ang_vel: (T, 3) rad/s, world frame.
        links: as of `forward_kinematics`, the same as for `poses`.
        points: (L, 3) points in the link frames, m, whose linear velocities are computed; None:
            the origins.
    """
    pos, quat = (part.transpose(1, 2, 0) for part in poses)
    lin, ang = np.full(pos.shape, np.nan), np.full(pos.shape, np.nan)
    lin[0], ang[0] = root_lin_vel.T, root_ang_vel.T
    speed = joint_vel.T[robot.joint_of_link, None]  # a link without a joint has the axis zero
    *_, axis = _matrices(robot)
    offset = _turning(np.zeros_like(robot.origin_pos) if points is None else points)
    shift = np.zeros(pos.shape)
    shift[:1] = _cross(ang[:1], offset[:1] @ _products(quat[:1]))
    for level in robot.levels if links is None else _levels(robot, tuple(links)):
        above, products = robot.parent[level], _products(quat[level])
        ang[level] = ang[above] + (axis[level] @ products) * speed[level]
        lin[level] = lin[above] + _cross(ang[above], pos[level] - pos[above])
        if points is not None:
            shift[level] = _cross(ang[level], offset[level] @ products)
    lin += shift
    return LinkVelocities(lin.transpose(2, 0, 1), ang.transpose(2, 0, 1))


def pose_blocks(
    robot: G1,
    joint_pos: Floats,
    root_pos: Floats,
    root_quat_wxyz: Floats,
    links: Sequence[int] | None = None,
) -> Iterator[tuple[slice, LinkPoses]]:
    """Apply `forward_kinematics` to blocks of `BLOCK` frames, with constant memory.

    Args:
        robot: the robot.
        joint_pos: (T, 29) rad, motor order.
        root_pos: (T, 3) m.
        root_quat_wxyz: (T, 4) unit quaternions.
        links: as of `forward_kinematics`.

    Yields:
        The slice of frames, in order, and the poses of their links.
    """
    for first in range(0, len(joint_pos), BLOCK):
        part = slice(first, min(first + BLOCK, len(joint_pos)))
        pose = joint_pos[part], root_pos[part], root_quat_wxyz[part]
        yield part, forward_kinematics(robot, *pose, links)


@lru_cache(maxsize=2 * KEPT_ROBOTS)  # a few sets of links for each robot
def _levels(robot: G1, links: tuple[int, ...]) -> tuple[NDArray[np.intp], ...]:
    """`robot.levels`, reduced to the given links and those between them and the root."""
    wanted = set(links)
    for level in reversed(robot.levels):
        wanted.update(int(robot.parent[link]) for link in level if link in wanted)
    return tuple(level[np.isin(level, list(wanted))] for level in robot.levels)


@lru_cache(maxsize=KEPT_ROBOTS)
def _matrices(robot: G1) -> tuple[Floats, Floats, Floats]:
    """Constant matrices of each link's pose: (L, 8, 4), (L, 3, 16) and (L, 3, 16).

    The product of a quaternion (4,) with a constant one is linear in its components. The first
    matrices multiply the parent's quaternion by the two constants of `local_transforms`. The
    rotation of a constant vector is linear in the products (16,) of the components. The other two
    rotate the link's origin by the parent's quaternion, and the link's axis by its own.
    """
    unit = np.eye(4)[:, None]
    times = [quat_mul(unit, one) for one in (robot.origin_quat_wxyz, _turned(robot))]
    mixed = np.ascontiguousarray(np.concatenate(times, axis=-1).transpose(1, 2, 0))
    return mixed, _turning(robot.origin_pos), _turning(robot.axis)


def _turning(vectors: Floats) -> Floats:
    """(L, 3, 16) matrices that rotate vectors (L, 3), when multiplied by `_products`."""
    unit = np.eye(4)[:, None]
    pure = np.concatenate([np.zeros((len(vectors), 1)), vectors], axis=1)
    turned = quat_mul(quat_mul(unit[:, None], pure), quat_conj(unit))[..., 1:]
    return np.ascontiguousarray(turned.reshape(16, -1, 3).transpose(1, 2, 0))


def _products(quat: Floats) -> Floats:
    """(N, 16, T) products of all pairs of components of quaternions (N, 4, T)."""
    products: Floats = (quat[:, :, None] * quat[:, None]).reshape(len(quat), 16, quat.shape[2])
    return products


def _cross(a: Floats, b: Floats) -> Floats:
    """The cross products (N, 3, T) of vectors (N, 3, T)."""
    (ax, ay, az), (bx, by, bz) = a.transpose(1, 0, 2), b.transpose(1, 0, 2)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _n_frames(robot: G1, joint_pos: Floats) -> int:
    n_joints = len(robot.joint_names)
    if joint_pos.ndim != 2 or joint_pos.shape[1] != n_joints:
        raise ValueError(f"joint_pos must have the shape (T, {n_joints}), not {joint_pos.shape}")
    return len(joint_pos)


def _turned(robot: G1) -> Floats:
    """(L, 4) quaternion of each link relative to its parent with its joint at pi."""
    axis = np.concatenate([np.zeros((len(robot.axis), 1)), robot.axis], axis=1)
    return quat_mul(robot.origin_quat_wxyz, axis)
