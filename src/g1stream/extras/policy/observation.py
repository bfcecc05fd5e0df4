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
    quat_rotate,
    quat_rotate_inverse,
    quat_to_rpy,
    rotation_matrices,
)
from g1stream.types import Floats

__all__ = ["REPEATED", "TERMS", "Inputs", "Pose", "ReferenceFrame", "RobotState"]


class Pose(NamedTuple):
    """Pose of a link in the world: pos (3,) m, quat_wxyz (4,) unit."""

    pos: Floats
    quat_wxyz: Floats


class RobotState(NamedTuple):
    """The measured or estimated state of the robot.

    Attributes:
        joint_pos: (29,) rad, motor order.
        joint_vel: (29,) rad/s.
        quat_wxyz: (4,) pelvis in the world, unit.
        gyroscope: (3,) angular velocity in the pelvis frame, rad/s.
        lin_vel: (3,) velocity of the pelvis, in the pelvis frame, m/s.
        anchor: pose of the anchor link.
    """

    joint_pos: Floats
    joint_vel: Floats
    quat_wxyz: Floats
    gyroscope: Floats
    lin_vel: Floats
    anchor: Pose


_UNKNOWN: Final = Pose(np.full(3, np.nan), np.full(4, np.nan))


class ReferenceFrame(NamedTuple):
    """The reference of one step.

    Attributes:
        joint_pos: (29,) rad, motor order.
        joint_vel: (29,) rad/s.
        anchor: pose of the anchor link.
        phase: share of the motion that has passed, 0 before it and 1 after it.
        pelvis: pose of the pelvis; NaN if unknown, as are its velocities.
        lin_vel: (3,) velocity of the pelvis, in the pelvis frame, m/s.
        ang_vel: (3,) angular velocity in the pelvis frame, rad/s.
    """

    joint_pos: Floats
    joint_vel: Floats
    anchor: Pose
    phase: float = 0.0
    pelvis: Pose = _UNKNOWN
    lin_vel: Floats = _UNKNOWN.pos
    ang_vel: Floats = _UNKNOWN.pos


class Inputs(NamedTuple):
    """All values that a term may use.

    Attributes:
        state: state of the robot.
        reference: None for a policy that tracks no motion.
        yaw0: (4,) quaternion wxyz, from the reference's world to the robot's.
        origin: origin of the reference's world and of the robot's, each (3,), m: the place of the
            anchor link at the start of the motion, at height 0, because both have their floor
            there.
        order: (joints,) motor index of each joint of the policy.
        default_pos: (joints,) rad.
        last_action: (joints,) output of the network in the step before.
        velocity: (3,) command: forward and to the left, m/s, and turning left, rad/s.
        phase: (2,) phase of the left and the right leg, rad; pi, pi while standing.
    """

    state: RobotState
    reference: ReferenceFrame | None
    yaw0: Floats
    origin: tuple[Floats, Floats]
    order: NDArray[np.intp]
    default_pos: Floats
    last_action: Floats
    velocity: Floats
    phase: Floats


class _Term(NamedTuple):
    """Number of values in all and for each joint, formula in words, and the values."""

    size: int
    by_joint: int
    formula: str
    value: Callable[[Inputs], Floats]


def _command(x: Inputs) -> Floats:
    reference = _reference(x)
    return np.concatenate([reference.joint_pos[x.order], reference.joint_vel[x.order]])


def _anchor_orientation(x: Inputs) -> Floats:
    turned = quat_mul(x.yaw0, _reference(x).anchor.quat_wxyz)
    matrix = rotation_matrices(quat_mul(quat_conj(x.state.anchor.quat_wxyz), turned))
    return matrix[:, :2].ravel()


def _anchor_position(x: Inputs) -> Floats:
    begin, own_begin = x.origin
    place = own_begin + quat_rotate(x.yaw0, _reference(x).anchor.pos - begin)
    return quat_rotate_inverse(x.state.anchor.quat_wxyz, place - x.state.anchor.pos)


def _roll_pitch(quat_wxyz: Floats) -> Floats:
    return np.array(quat_to_rpy(quat_wxyz)[:2])


def _gravity(x: Inputs) -> Floats:
    return quat_rotate_inverse(x.state.quat_wxyz, np.array([0.0, 0.0, -1.0]))


def _reference(x: Inputs) -> ReferenceFrame:
    if x.reference is None:
        raise ValueError("the observation has a term that needs a reference")
    return x.reference


TERMS: Final = {
    "motion_command": _Term(0, 2, "q_ref, dq_ref", _command),
    "motion_anchor_pos_b": _Term(3, 0, "R(q_anchor)^-1 (p_ref - p_anchor)", _anchor_position),
    "motion_anchor_ori_b": _Term(
        6, 0, "R(q_anchor^-1 yaw0 q_ref), 2 columns, by rows", _anchor_orientation
    ),
    "base_lin_vel": _Term(3, 0, "velocity of the pelvis in its axes", lambda x: x.state.lin_vel),
    "base_ang_vel": _Term(3, 0, "gyroscope of the pelvis", lambda x: x.state.gyroscope),
    "projected_gravity": _Term(3, 0, "R(q_pelvis)^-1 (0, 0, -1)", _gravity),
    "velocity_commands": _Term(3, 0, "commanded vx, vy, yaw rate", lambda x: x.velocity),
    "command_lin_vel": _Term(2, 0, "commanded vx, vy", lambda x: x.velocity[:2]),
    "command_ang_vel": _Term(1, 0, "commanded yaw rate", lambda x: x.velocity[2:]),
    "sin_phase": _Term(2, 0, "sine of the legs' phase", lambda x: np.sin(x.phase)),
    "cos_phase": _Term(2, 0, "cosine of the legs' phase", lambda x: np.cos(x.phase)),
    "joint_pos_rel": _Term(
        0, 1, "q - default", lambda x: x.state.joint_pos[x.order] - x.default_pos
    ),
    "joint_vel_rel": _Term(0, 1, "dq", lambda x: x.state.joint_vel[x.order]),
    "last_action": _Term(0, 1, "action of the step before", lambda x: x.last_action),
    "motion_phase": _Term(
        1, 0, "share of the motion that has passed", lambda x: np.array([_reference(x).phase])
    ),
    "motion_joint_pos": _Term(0, 1, "q_ref", lambda x: _reference(x).joint_pos[x.order]),
    "motion_lin_vel_xy": _Term(
        2,
        0,
        "velocity of the reference's pelvis in its axes: x, y",
        lambda x: _reference(x).lin_vel[:2],
    ),
    "motion_height": _Term(
        1, 0, "height of the reference's pelvis", lambda x: _reference(x).pelvis.pos[2:]
    ),
    "motion_roll_pitch": _Term(
        2,
        0,
        "roll and pitch of the reference's pelvis",
        lambda x: _roll_pitch(_reference(x).pelvis.quat_wxyz),
    ),
    "motion_yaw_rate": _Term(
        1,
        0,
        "turning of the reference's pelvis about its z axis",
        lambda x: _reference(x).ang_vel[2:],
    ),
    "base_roll_pitch": _Term(
        2, 0, "roll and pitch of the pelvis", lambda x: _roll_pitch(x.state.quat_wxyz)
    ),
}
"""The terms by their names in Isaac Lab and mjlab, as in deploy.yaml, where these have them."""
REPEATED: Final = "repeated"
"""Name in a session of a term with the values of other terms."""
