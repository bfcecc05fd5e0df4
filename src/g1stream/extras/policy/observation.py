"""The terms of a policy's observation: names, sizes and formulas.

R(q) is the rotation from a body's axes to the world's, q_anchor the measured attitude of the anchor
link, and q_ref that of the reference. yaw0 is the heading of the robot's anchor minus the
reference's at the start of the motion; p_ref is turned and moved by the same transform. Joints are
in the policy's order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from g1stream.robot.rotations import (
    quat_conj,
    quat_mul,
    quat_rotate_inverse,
    quat_to_rpy,
    rotation_matrices,
)
from g1stream.types import Floats

__all__ = ["REPEATED", "TERMS", "Body", "Inputs", "Pose", "body"]


_ORIGIN: Final = np.zeros(3)
#: Phase of the left and the right leg, rad. A robot in a run has no walking command: it stands.
_STANDING: Final = np.full(2, np.pi)


class Pose(NamedTuple):
    """Pose of a link in the world: pos (3,) m, quat_wxyz (4,) unit."""

    pos: Floats
    quat_wxyz: Floats


class Body(NamedTuple):
    """A state of the robot, measured or of the reference.

    Attributes:
        joint_pos: (29,) rad, motor order.
        joint_vel: (29,) rad/s.
        quat_wxyz: (4,) pelvis in the world, unit.
        ang_vel: (3,) of the pelvis in its own axes, rad/s; of the robot, its gyroscope.
        pos: (3,) pelvis in the world, m.
        lin_vel: (3,) of the pelvis in the world, m/s.
        phase: share of the motion that has passed, 0 before it and 1 after it; of the reference.
    """

    joint_pos: Floats
    joint_vel: Floats
    quat_wxyz: Floats
    ang_vel: Floats
    pos: Floats
    lin_vel: Floats
    phase: float = 0.0


def body(
    joint_pos: NDArray[np.floating],
    joint_vel: NDArray[np.floating],
    quat_wxyz: NDArray[np.floating],
    ang_vel: NDArray[np.floating],
    pos: NDArray[np.floating] = _ORIGIN,
    lin_vel: NDArray[np.floating] = _ORIGIN,
) -> Body:
    """A `Body` in double precision, with a unit quaternion, from values of any precision."""
    values = (joint_pos, joint_vel, quat_wxyz, ang_vel, pos, lin_vel)
    q, dq, quat, turn, place, velocity = (one.astype(np.float64) for one in values)
    return Body(q, dq, quat / np.sqrt(quat @ quat), turn, place, velocity)


class Inputs(NamedTuple):
    """All values that a term may use.

    Attributes:
        state: state of the robot.
        reference: of a policy that tracks a motion.
        anchor, reference_anchor: their poses of the anchor link, both in the robot's world.
        order: (joints,) motor index of each joint of the policy.
        default_pos: (joints,) rad.
        last_action: (joints,) output of the network in the step before.
    """

    state: Body
    reference: Body
    anchor: Pose
    reference_anchor: Pose
    order: NDArray[np.intp]
    default_pos: Floats
    last_action: Floats


class _Term(NamedTuple):
    """Number of values in all and for each joint, formula in words, and the values."""

    size: int
    by_joint: int
    formula: str
    value: Callable[[Inputs], Floats]


def _command(x: Inputs) -> Floats:
    return np.concatenate([x.reference.joint_pos[x.order], x.reference.joint_vel[x.order]])


def _anchor_orientation(x: Inputs) -> Floats:
    turn = quat_mul(quat_conj(x.anchor.quat_wxyz), x.reference_anchor.quat_wxyz)
    matrix = rotation_matrices(turn)
    return matrix[:, :2].ravel()


def _anchor_position(x: Inputs) -> Floats:
    return quat_rotate_inverse(x.anchor.quat_wxyz, x.reference_anchor.pos - x.anchor.pos)


def _roll_pitch(of: Body) -> Floats:
    return np.array(quat_to_rpy(of.quat_wxyz)[:2])


def _lin_vel(of: Body) -> Floats:
    return quat_rotate_inverse(of.quat_wxyz, of.lin_vel)


def _gravity(x: Inputs) -> Floats:
    return quat_rotate_inverse(x.state.quat_wxyz, np.array([0.0, 0.0, -1.0]))


TERMS: Final = {
    "motion_command": _Term(0, 2, "q_ref, dq_ref", _command),
    "motion_anchor_pos_b": _Term(3, 0, "R(q_anchor)^-1 (p_ref - p_anchor)", _anchor_position),
    "motion_anchor_ori_b": _Term(
        6, 0, "R(q_anchor^-1 yaw0 q_ref), 2 columns, by rows", _anchor_orientation
    ),
    "base_lin_vel": _Term(3, 0, "velocity of the pelvis in its axes", lambda x: _lin_vel(x.state)),
    "base_ang_vel": _Term(3, 0, "gyroscope of the pelvis", lambda x: x.state.ang_vel),
    "projected_gravity": _Term(3, 0, "R(q_pelvis)^-1 (0, 0, -1)", _gravity),
    "velocity_commands": _Term(3, 0, "commanded vx, vy, yaw rate", lambda x: np.zeros(3)),
    "command_lin_vel": _Term(2, 0, "commanded vx, vy", lambda x: np.zeros(2)),
    "command_ang_vel": _Term(1, 0, "commanded yaw rate", lambda x: np.zeros(1)),
    "sin_phase": _Term(2, 0, "sine of the legs' phase", lambda x: np.sin(_STANDING)),
    "cos_phase": _Term(2, 0, "cosine of the legs' phase", lambda x: np.cos(_STANDING)),
    "joint_pos_rel": _Term(
        0, 1, "q - default", lambda x: x.state.joint_pos[x.order] - x.default_pos
    ),
    "joint_vel_rel": _Term(0, 1, "dq", lambda x: x.state.joint_vel[x.order]),
    "last_action": _Term(0, 1, "action of the step before", lambda x: x.last_action),
    "motion_phase": _Term(
        1, 0, "share of the motion that has passed", lambda x: np.array([x.reference.phase])
    ),
    "motion_joint_pos": _Term(0, 1, "q_ref", lambda x: x.reference.joint_pos[x.order]),
    "motion_lin_vel_xy": _Term(
        2, 0, "velocity of the reference's pelvis in its axes", lambda x: _lin_vel(x.reference)[:2]
    ),
    "motion_height": _Term(1, 0, "height of the reference's pelvis", lambda x: x.reference.pos[2:]),
    "motion_roll_pitch": _Term(
        2, 0, "roll and pitch of the reference's pelvis", lambda x: _roll_pitch(x.reference)
    ),
    "motion_yaw_rate": _Term(
        1, 0, "rate of the reference's pelvis about its z axis", lambda x: x.reference.ang_vel[2:]
    ),
    "base_roll_pitch": _Term(2, 0, "roll and pitch of the pelvis", lambda x: _roll_pitch(x.state)),
}
"""The terms by their names in Isaac Lab and mjlab, as in deploy.yaml, where these have them."""
REPEATED: Final = "repeated"
"""Name in a session of a term with the values of other terms."""
