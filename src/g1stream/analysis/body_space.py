"""How closely the links of the robot followed those of the reference, in metres."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.analysis.frames import FPS
from g1stream.analysis.tracking import blocks
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.kinematics import BLOCK, LinkPoses, forward_kinematics
from g1stream.robot.rotations import quat_conj, quat_mul, quat_rotate, quat_rotate_inverse
from g1stream.session.metrics import (
    BodyMetrics,
    EndEffectorMetrics,
    LinkMetrics,
    PelvisMetrics,
    TerminationMetrics,
)
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.analysis.frames import Frames, Robot
    from g1stream.robot.model import G1

__all__ = ["END_EFFECTORS", "body_metrics"]

END_EFFECTORS: Final = (
    "left_ankle_roll_link",
    "right_ankle_roll_link",
    "left_wrist_yaw_link",
    "right_wrist_yaw_link",
)
"""Those of BeyondMimic's tasks for the G1."""

_DOWN: Final = np.array([0.0, 0.0, -1.0])
_MM: Final = 1e3


def body_metrics(robot: G1, frames: Frames, joints: Sequence[int] = range(N_JOINTS)) -> BodyMetrics:
    """The metrics of the links, in the world, relative to the pelvis's position and in its frame.

    Links are the bodies of the G1, the pelvis and those that a joint has: all of them, or where
    only some joints were played those that these move.

    Args:
        robot: the links.
        frames: the reference and what was measured.
        joints: motor indices of those that were played.
    """
    bodies = np.flatnonzero(_moved(robot, joints))
    names = [robot.link_names[i] for i in bodies]
    reference, measured = frames.reference, frames.measured
    ends = [names.index(name) for name in END_EFFECTORS if name in names]
    n_frames = len(frames.motion_time)
    alone, relative = np.empty((2, n_frames, len(bodies), 3))
    asked, done = (
        LinkPoses(np.empty((n_frames, len(ends), 3)), np.empty((n_frames, len(ends), 4)))
        for _ in range(2)
    )
    for part in blocks(n_frames, BLOCK):
        of_reference = _links(robot, reference, part, bodies)
        of_measured = _links(robot, measured, part, bodies)
        alone[part] = of_reference[0].pos - of_measured[0].pos
        relative[part] = of_reference[1] - of_measured[1]
        for kept, (links, _) in ((asked, of_reference), (done, of_measured)):
            kept.pos[part], kept.quat_wxyz[part] = links.pos[:, ends], links.quat_wxyz[:, ends]
    world = terminations = None
    if frames.has_position:
        apart = reference.root_pos - measured.root_pos
        world = relative + apart[:, np.newaxis]
        terminations = TerminationMetrics(
            max_pelvis_height_mm=float(np.abs(apart[:, 2]).max() * _MM),
            max_gravity_difference=_gravity_difference(reference, measured),
            max_end_effector_height_mm=float(np.abs(world[:, ends, 2]).max(initial=0.0) * _MM),
        )
    return BodyMetrics(
        fps=FPS,
        frames=n_frames,
        world=None if world is None else _link_metrics(frames, names, world),
        root_relative=_link_metrics(frames, names, relative) if frames.has_attitude else None,
        pelvis_frame=_link_metrics(frames, names, alone),
        end_effectors={names[link]: _end_effector(asked, done, i) for i, link in enumerate(ends)},
        pelvis=_pelvis_metrics(frames) if frames.has_attitude else None,
        terminations=terminations,
    )


def _moved(robot: G1, joints: Sequence[int]) -> NDArray[np.bool_]:
    """(L,) which bodies the played joints move; the pelvis, too, if all joints were played."""
    bodies = robot.joint_of_link >= 0
    played = np.isin(robot.joint_of_link, joints)
    if np.array_equal(played, bodies):
        return np.asarray(bodies | (robot.parent < 0))
    moved = played.copy()
    for link in range(1, len(moved)):  # parents come before children
        moved[link] |= moved[robot.parent[link]]
    return np.asarray(moved & bodies)


def _links(
    robot: G1, state: Robot, part: slice, bodies: NDArray[np.intp]
) -> tuple[LinkPoses, Floats]:
    """Poses of L bodies in the pelvis's frame, and their positions (F, L, 3) with its attitude."""
    poses = forward_kinematics(robot, state.q[part], np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    links = LinkPoses(poses.pos[:, bodies], poses.quat_wxyz[:, bodies])
    axes = quat_rotate(state.root_quat_wxyz[part, np.newaxis], np.eye(3))
    return links, links.pos @ axes


def _link_metrics(frames: Frames, names: list[str], difference: Floats) -> LinkMetrics:
    """Of the positions (F, L, 3) m, reference - measured."""
    distance = _norm(difference)
    of_frame = distance.mean(axis=1)
    worst = int(of_frame.argmax())
    both = frames.consecutive
    velocity = np.diff(difference, axis=0)
    vel = _mean_norm(velocity[both])
    acc = _mean_norm(np.diff(velocity, axis=0)[both[1:] & both[:-1]])
    return LinkMetrics(
        mpjpe_mm=float(of_frame.mean() * _MM),
        p99_mm=float(np.percentile(of_frame, 99.0) * _MM),
        max_mm=float(of_frame[worst] * _MM),
        max_at_s=float(frames.motion_time[worst]),
        vel_mm_per_frame=vel,
        acc_mm_per_frame2=acc,
        by_link_mm=dict(zip(names, (distance.mean(axis=0) * _MM).tolist(), strict=True)),
    )


def _mean_norm(vectors: Floats) -> float | None:
    """Mean length of vectors (F, L, 3) m, mm; None without a frame."""
    return float(_norm(vectors).mean() * _MM) if len(vectors) else None


def _norm(vectors: Floats) -> Floats:
    """(...) of vectors (..., 3); numpy's own takes twice as long."""
    length: Floats = np.sqrt(np.einsum("...k,...k", vectors, vectors))
    return length


def _end_effector(asked: LinkPoses, done: LinkPoses, link: int) -> EndEffectorMetrics:
    distance = np.linalg.norm(asked.pos[:, link] - done.pos[:, link], axis=-1)
    angle = _angle(asked.quat_wxyz[:, link], done.quat_wxyz[:, link])
    return EndEffectorMetrics(
        position_mm=float(distance.mean() * _MM),
        max_position_mm=float(distance.max() * _MM),
        orientation_rad=float(angle.mean()),
    )


def _pelvis_metrics(frames: Frames) -> PelvisMetrics:
    reference, measured = frames.reference, frames.measured
    angle = _angle(reference.root_quat_wxyz, measured.root_quat_wxyz)
    yaw_rate = np.abs(reference.root_ang_vel[:, 2] - measured.root_ang_vel[:, 2])
    distance = np.linalg.norm(reference.root_pos - measured.root_pos, axis=1) * _MM
    speed = np.linalg.norm(reference.root_lin_vel - measured.root_lin_vel, axis=1)
    known = frames.has_position
    return PelvisMetrics(
        orientation_rad=float(angle.mean()),
        max_orientation_rad=float(angle.max()),
        yaw_rate_rad_s=float(yaw_rate.mean()),
        position_mm=float(distance.mean()) if known else None,
        max_position_mm=float(distance.max()) if known else None,
        final_position_mm=float(distance[-1]) if known else None,
        lin_vel_m_s=float(speed.mean()) if known else None,
    )


def _angle(a: Floats, b: Floats) -> Floats:
    """(F,) rad between rotations (F, 4)."""
    difference = quat_mul(quat_conj(a), b)
    angle: Floats = 2.0 * np.arctan2(
        np.linalg.norm(difference[:, 1:], axis=1), np.abs(difference[:, 0])
    )
    return angle


def _gravity_difference(reference: Robot, measured: Robot) -> float:
    down = [
        quat_rotate_inverse(one.root_quat_wxyz, np.broadcast_to(_DOWN, one.root_pos.shape))[:, 2]
        for one in (reference, measured)
    ]
    return float(np.abs(down[0] - down[1]).max())
