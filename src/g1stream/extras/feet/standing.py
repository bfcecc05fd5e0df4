"""Equations of motion of a robot whose feet stand on the floor, or are lifted.

With a = (base's acceleration, joints' acceleration) and a wrench w of the floor on each sole,

    M(q) a + h(q, v) = (0, tau - friction) + J(q)^T w,    J(q) a + J'(q, v) v = 0

(R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapter 8). The second equation keeps the
soles at rest; it gives the legs' acceleration from the base's. The accelerations of waist and arms
are given, and those of a lifted leg, whose w is 0. The only free variables are the components of w,
and everything else is linear in them.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from g1stream.robot.dynamics import GRAVITY, friction_torque, mujoco_spec
from g1stream.robot.joints import JOINT_NAMES, LEGS
from g1stream.robot.model import G1
from g1stream.robot.soles import Soles
from g1stream.types import Floats

_BASE: Final = 6
_ROOT: Final = 1  # the base, after the world
_WRENCHES: Final = 12

#: Added to the squares of a leg's singular values, to limit speeds at a stretched knee.
_DAMPING: Final = 1e-6 * np.eye(6)


class BodyState(NamedTuple):
    """State of the robot without position and velocity of its base."""

    quat_wxyz: Floats  # (4,) pelvis to world
    ang_vel: Floats  # (3,) rad/s, pelvis frame
    q: Floats  # (29,) rad, motor order
    dq: Floats  # (29,) rad/s


class Movement(NamedTuple):
    """Centre of mass and soles of a reference."""

    pos: Floats  # (3,) m, world, centre of mass
    vel: Floats  # (3,) m/s, world
    force: Floats  # (3,) N, world, contact force that this needs, including the weight
    soles: Floats  # (2, 3) m, world, middle of each sole


class Terms(NamedTuple):
    """Terms of a state. Vectors are relative to the base's origin, or to its velocity, world.

    Accelerations and torques are linear in the wrenches w (12,): force, N, and moment about the
    middle of the sole, N·m, world, left foot first.
    """

    soles: Floats  # (2, 3) m, middle of each sole
    turns: Floats  # (2, 3, 3) foot to world
    sole_vel: Floats  # (2, 3) m/s
    centre: Floats  # (3,) m, centre of mass
    centre_vel: Floats  # (3,) m/s
    # (6, 12) and (6,): B w + b is the base's acceleration, m/s², world, and rad/s², pelvis frame.
    base_acc: tuple[Floats, Floats]
    leg_tau: tuple[Floats, Floats]  # (12, 12) and (12,), N·m, of the legs
    other_tau: tuple[Floats, Floats]  # (17, 12) and (17,), N·m, of waist and arms
    gravity_tau: Floats  # (29,) N·m, holds the joints against gravity if the base is held
    # (2, 6, 6) joint motion of a leg per motion of its sole: the damped inverse of its Jacobian.
    # Its transpose gives the wrench on a sole from the torques of its leg.
    by_sole: Floats


class StandingDynamics:
    """Equations of motion of a robot with `mass` kg and `weight` N.

    `sole` (4, 2), m, has the corners of a sole about its middle, in the foot's frame.
    """

    def __init__(self, robot: G1) -> None:
        import mujoco

        soles = Soles(robot)
        self._parameters = robot.parameters
        self._mujoco: Any = mujoco
        model = mujoco_spec(robot, floating=True, shapes=False).compile()
        model.opt.gravity[:] = 0.0, 0.0, -GRAVITY
        self._model: Any = model
        self._data, self._reference = mujoco.MjData(model), mujoco.MjData(model)
        joints = [model.joint(name) for name in JOINT_NAMES]
        self._q = np.array([joint.qposadr[0] for joint in joints])
        self._v = np.array([joint.dofadr[0] for joint in joints])
        self._feet = [model.body(robot.link_names[link]).id for link in soles.links]
        self._middle = soles.corners.mean(axis=1)
        self.mass = float(model.body_mass.sum())
        self.weight = self.mass * GRAVITY
        self.sole: Floats = (soles.corners[0] - self._middle[0])[:, :2]
        n = model.nv
        self._inertia, self._bias = np.zeros((n, n)), np.zeros(n)
        self._jac, self._jac_rate = np.zeros((2, _WRENCHES, n))
        self._force = np.zeros(n)

    def movement(
        self, state: BodyState, pos: Floats, lin_vel: Floats, acc: tuple[Floats, Floats, Floats]
    ) -> Movement:
        """The movement of a reference whose base is at `pos` and has `lin_vel`, world.

        `acc` is that of its base, (3,) m/s² world and (3,) rad/s² pelvis frame, and its joints
        (29,).
        """
        mujoco, model, data = self._mujoco, self._model, self._reference
        self._place(data, state)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        data.qacc[:3], data.qacc[3:_BASE], data.qacc[self._v] = acc
        mujoco.mj_rne(model, data, 1, self._force)
        return Movement(
            data.subtree_com[_ROOT] + pos,
            data.subtree_linvel[_ROOT] + lin_vel,
            self._force[:3].copy(),
            self._find_soles(data)[0] + pos,
        )

    def sole_poses(self, state: BodyState) -> tuple[Floats, Floats]:
        """The middle of each sole (2, 3), m from the base's origin, and foot to world (2, 3, 3)."""
        self._place(self._reference, state)
        return self._find_soles(self._reference)

    def soles(self, state: BodyState) -> tuple[Floats, Floats]:
        """The middle of each sole (2, 3), m from the base's origin, world, and its heading (2,)."""
        pos, turns = self.sole_poses(state)
        return pos, np.arctan2(turns[:, 1, 0], turns[:, 0, 0])

    def towards(self, state: BodyState, soles: Floats, turns: Floats) -> Floats:
        """The joints (29,), rad, after a step of Newton's method towards the given sole poses.

        These are (2, 3) m from the base's origin, world, and (2, 3, 3) foot to world.
        """
        now, turned = self.sole_poses(state)
        self._find_sole_jacobians(self._reference, now)
        skew = turns @ turned.transpose(0, 2, 1)
        skew = 0.5 * (skew - skew.transpose(0, 2, 1))
        turn = skew[:, [2, 0, 1], [1, 2, 0]]
        q: Floats = state.q.copy()
        q[:LEGS] += self._by_legs(np.concatenate([soles - now, turn], axis=1))
        return q

    def joint_motion(self, state: BodyState, vel: Floats, acc: Floats) -> tuple[Floats, Floats]:
        """Leg velocities (29,), rad/s, and accelerations, rad/s², for soles at rest.

        The base has `vel` and `acc` (3,), world, and does not turn; waist and arms rest.
        """
        dq, ddq = np.zeros((2, len(JOINT_NAMES)))
        still = np.zeros((2, 3))
        now, _ = self.sole_poses(state)
        self._find_sole_jacobians(self._reference, now)
        dq[:LEGS] = self._by_legs(np.concatenate([still - vel, still], axis=1))
        self._place(self._reference, state._replace(dq=dq))
        self._mujoco.mj_comVel(self._model, self._reference)
        rate = self._find_sole_jacobians(self._reference, now, rate=True)
        moved = (rate @ self._reference.qvel).reshape(2, 6)
        ddq[:LEGS] = self._by_legs(np.concatenate([still - acc, still], axis=1) - moved)
        return dq, ddq

    def _by_legs(self, wanted: Floats) -> Floats:
        """Joint part (12,) of a desired motion of the soles (2, 6), by the last Jacobians."""
        moved: Floats = _inverse(_of_legs(self._jac)) @ wanted[:, :, np.newaxis]
        return moved.reshape(LEGS)

    def _find_sole_jacobians(self, data: Any, soles: Floats, *, rate: bool = False) -> Floats:
        """The Jacobian (12, 35) of the soles, or its time derivative."""
        mujoco: Any = self._mujoco
        found: Floats = self._jac_rate if rate else self._jac
        find = mujoco.mj_jacDot if rate else mujoco.mj_jac
        for foot, sole, row in zip(self._feet, soles, (0, 6), strict=True):
            find(self._model, data, found[row : row + 3], found[row + 3 : row + 6], sole, foot)
        return found

    def terms(
        self,
        state: BodyState,
        acc: Floats,
        friction_at: Floats,
        other: Floats,
        stands: tuple[bool, bool] = (True, True),
    ) -> Terms:
        """The terms of a state.

        Args:
            state: measured state.
            acc: (29,) rad/s², accelerations of waist, arms and a lifted leg.
            friction_at: (29,) rad/s, velocities for the joints' friction.
            other: (3,) N, world, external force on the base.
            stands: which feet stand.
        """
        mujoco, model, data = self._mujoco, self._model, self._data
        m, h = self._inertia, self._bias
        self._place(data, state)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        mujoco.mj_makeM(model, data)
        self._fill_inertia(data)
        mujoco.mj_rne(model, data, 0, h)
        soles, turns = self._find_soles(data)
        jac = self._find_sole_jacobians(data, soles)
        rate = self._find_sole_jacobians(data, soles, rate=True)
        v = data.qvel
        moved = (jac @ v).reshape(2, 6)
        base, legs, others = slice(0, _BASE), slice(_BASE, _BASE + LEGS), slice(_BASE + LEGS, None)
        # The legs' acceleration is L (base's acceleration) + l.
        by_sole = _inverse(_of_legs(jac))
        to_soles = np.concatenate([jac[:, base], (rate @ v)[:, np.newaxis]], axis=1)
        led = -by_sole @ to_soles.reshape(2, 6, 7)
        for foot in (foot for foot in (0, 1) if not stands[foot]):
            led[foot, :, :6], led[foot, :, 6] = 0.0, acc[6 * foot : 6 * foot + 6]
        led = led.reshape(LEGS, 7)
        m_bl = m[base, legs]
        given = m[:, others] @ acc[LEGS:] + h
        inertia = m[base, base] + m_bl @ led[:, :6]
        known = given[:_BASE] + m_bl @ led[:, 6]
        known[:3] -= other
        base_acc = np.linalg.solve(
            inertia, np.concatenate([jac[:, base].T, -known[:, np.newaxis]], axis=1)
        )
        leg_acc = led[:, :6] @ base_acc
        leg_acc[:, -1] += led[:, 6]
        tau = m[_BASE:, base] @ base_acc + m[_BASE:, legs] @ leg_acc
        tau[:, -1] += given[_BASE:] + friction_torque(friction_at, self._parameters)
        tau[:LEGS, :-1] -= jac[:, legs].T
        return Terms(
            soles,
            turns,
            moved[:, :3],
            data.subtree_com[_ROOT].copy(),
            data.subtree_linvel[_ROOT].copy(),
            (base_acc[:, :-1], base_acc[:, -1]),
            (tau[:LEGS, :-1], tau[:LEGS, -1]),
            (tau[LEGS:, :-1], tau[LEGS:, -1]),
            h[_BASE:].copy(),
            by_sole,
        )

    def _place(self, data: Any, state: BodyState) -> None:
        data.qpos[3:7] = state.quat_wxyz
        data.qpos[self._q] = state.q
        data.qvel[3:_BASE] = state.ang_vel
        data.qvel[self._v] = state.dq
        self._mujoco.mj_kinematics(self._model, data)
        self._mujoco.mj_comPos(self._model, data)

    def _fill_inertia(self, data: Any) -> None:
        """Write M as a full matrix. MuJoCo's function had other arguments before version 4."""
        if hasattr(data, "qM"):
            self._mujoco.mj_fullM(self._model, self._inertia, data.qM)
        else:
            self._mujoco.mj_fullM(self._model, data, self._inertia)

    def _find_soles(self, data: Any) -> tuple[Floats, Floats]:
        turns = data.xmat[self._feet].reshape(2, 3, 3)
        pos: Floats = data.xpos[self._feet] + (turns @ self._middle[:, :, np.newaxis])[:, :, 0]
        return pos, turns


def _of_legs(jac: Floats) -> Floats:
    """The parts (2, 6, 6) of the soles' Jacobian (12, 35) for the joints of their legs."""
    return np.stack([jac[:6, _BASE : _BASE + 6], jac[6:, _BASE + 6 : _BASE + 12]])


def _inverse(jac: Floats) -> Floats:
    """The damped inverses of Jacobians (2, 6, 6)."""
    turned = jac.transpose(0, 2, 1)
    inverse: Floats = turned @ np.linalg.inv(jac @ turned + _DAMPING)
    return inverse
