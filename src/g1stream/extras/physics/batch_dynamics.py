"""Inverse dynamics of many frames at once: the results of `dynamics`, for recorded movements.

Newton-Euler equations of each body, outward from the pelvis for the accelerations and back for the
forces (R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapter 5), along the axes of the
world and about the pelvis's origin. A body is a link that a joint moves, with everything that is
fixed to it; body 0 is the pelvis. Inner arrays have components first and frames last, (3, B, T).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Final, NamedTuple

import numpy as np

from g1stream.robot.dynamics import GRAVITY, compiled_dynamics, friction_torque
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import LinkPoses
from g1stream.robot.model import G1
from g1stream.robot.rotations import rotation_matrices
from g1stream.robot.urdf import KEPT_ROBOTS
from g1stream.types import Floats

_UP: Final = np.array([[0.0], [0.0], [1.0]])
#: The link that carries a hanging robot.
_CARRIER: Final = "torso_link"
#: Closer than this to the mass centre, a carrier gives no hanging direction, m.
_NO_LEVER: Final = 1e-9


class BatchLoads(NamedTuple):
    """Loads of T frames."""

    tau: Floats  # (T, 29) N·m, motor order, friction included
    force: Floats  # (T, 3) N, world, external force that this movement of the pelvis needs
    moment: Floats  # (T, 3) N·m, world, of that force about the pelvis's origin


class BatchInverseDynamics:
    """The bodies of a robot with `mass` kg. A hanging robot hangs from its torso."""

    def __init__(self, robot: G1) -> None:
        import mujoco

        model = compiled_dynamics(robot, GRAVITY)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self.mass = float(model.body_mass.sum())
        moved_with = model.body_weldid
        bodies = np.unique(moved_with[1:])
        self.links = [robot.link_index(model.body(body).name) for body in bodies]
        self.joints = robot.joint_of_link[self.links[1:]]
        self.parents = np.searchsorted(bodies, moved_with[model.body_parentid[bodies[1:]]])
        self.carrier = int(np.searchsorted(bodies, moved_with[model.body(_CARRIER).id]))
        self.axes = robot.axis[self.links[1:]].T[..., np.newaxis]
        dofs = [model.joint(JOINT_NAMES[joint]).dofadr[0] for joint in self.joints]
        self.parameters = robot.parameters
        self.armature = model.dof_armature[dofs, np.newaxis]
        self.masses = np.empty((len(bodies), 1))
        self.centres = np.empty((3, len(bodies), 1))  # in the frame of the body
        self.inertias = np.empty((3, 3, len(bodies), 1))  # about that, in its frame
        for i, body in enumerate(bodies):
            fixed = np.flatnonzero(moved_with == body)
            mass, turn = model.body_mass[fixed], data.xmat[body].reshape(3, 3)
            places = (data.xipos[fixed] - data.xpos[body]) @ turn
            centre = mass @ places / mass.sum()
            axes = turn.T @ data.ximat[fixed].reshape(-1, 3, 3)
            inertia = (axes * model.body_inertia[fixed, np.newaxis]) @ axes.transpose(0, 2, 1)
            inertia = inertia.sum(axis=0) + _of_points(mass, (places - centre).T)
            self.masses[i], self.centres[:, i, 0] = mass.sum(), centre
            self.inertias[..., i, 0] = inertia

    @classmethod
    @lru_cache(maxsize=KEPT_ROBOTS)
    def of(cls, robot: G1) -> BatchInverseDynamics:
        """The object for a robot; it is cached."""
        return cls(robot)

    def batch(self, poses: LinkPoses, joint_vel: Floats, joint_acc: Floats) -> MovementBatch:
        """Frames for which loads are computed: world poses, rad/s and rad/s² (T, 29), motor order.

        Batches of `BLOCK` frames are fastest.
        """
        return MovementBatch(self, poses, joint_vel, joint_acc)


class MovementBatch:
    """T frames of a movement, for several ways to hold the pelvis.

    It is made by `BatchInverseDynamics.batch`.
    """

    def __init__(
        self, robot: BatchInverseDynamics, poses: LinkPoses, joint_vel: Floats, joint_acc: Floats
    ) -> None:
        self._robot = robot
        pos = poses.pos.T[:, robot.links]
        turn = rotation_matrices(poses.quat_wxyz.T[:, robot.links])
        self._pelvis = turn[:, :, 0]
        self._upright = self._pelvis[:, 2]
        self._origin = pos[:, 0]
        self._pos = pos - pos[:, :1]
        self._from_parent = self._pos[:, 1:] - self._pos[:, robot.parents]
        self._to_centre = _times(turn, robot.centres)
        self._centre = self._pos + self._to_centre
        self._inertia = _product(_product(turn, robot.inertias), turn.swapaxes(0, 1))
        self._axes = _times(turn[:, :, 1:], robot.axes)
        accelerations = joint_acc.T[robot.joints]
        self._joint_ang_vel = self._axes * joint_vel.T[robot.joints]
        self._joint_ang_acc = self._axes * accelerations
        self._rotor_torque = np.zeros_like(joint_vel)  # includes that of friction
        self._rotor_torque[:, robot.joints] = (robot.armature * accelerations).T
        friction = friction_torque(joint_vel, robot.parameters)
        self._rotor_torque[:, robot.joints] += friction[:, robot.joints]

    def bolted(self) -> Floats:
        """The torques (T, 29), N·m, with an upright pelvis at rest."""
        return self._loads(*self._held(GRAVITY * self._upright)).tau

    def hanging(self) -> tuple[Floats, Floats]:
        """The torques (T, 29), N·m, of a hanging robot, and the tilt (T,), rad, of its pelvis.

        The pelvis is at rest where the pose lets it hang, with the mass centre below the carrier's.
        It accelerates as the movement forces it to, while the carrier bears the weight.
        """
        robot, (forces, moments) = self._robot, self._at_rest
        centre = (robot.masses * self._centre).sum(axis=1) / robot.mass
        lever = self._centre[:, robot.carrier] - centre
        length = np.linalg.norm(lever, axis=0)
        up = np.where(length > _NO_LEVER, lever / np.maximum(length, _NO_LEVER), self._upright)
        tilt = np.arccos((up * self._upright).sum(axis=0).clip(-1.0, 1.0))
        # The weight has no moment about the mass centre.
        force = forces.sum(axis=1)
        moment = cross(centre, force) - moments.sum(axis=1)
        away = self._centre - centre[:, np.newaxis]
        inertia = self._inertia.sum(axis=2) + _of_points(robot.masses, away)
        ang_acc = np.linalg.solve(inertia.T, moment.T[..., np.newaxis])[..., 0].T
        acc = GRAVITY * up - force / robot.mass - cross(ang_acc, centre)
        forces, moments = self._held(acc, ang_acc)
        weight = robot.mass * GRAVITY * up
        forces[:, robot.carrier] -= weight
        moments[:, robot.carrier] -= cross(self._centre[:, robot.carrier], weight)
        return self._loads(forces, moments).tau, tilt

    def follow(self, ang_vel: Floats, ang_acc: Floats, lin_acc: Floats) -> BatchLoads:
        """The loads for given movements (T, 3) of the pelvis.

        Its rad/s and rad/s² are in its frame. The m/s² of its origin are in the world, without
        gravity.
        """
        moving = self._moving(
            _times(self._pelvis, ang_vel.T),
            _times(self._pelvis, ang_acc.T),
            lin_acc.T + GRAVITY * _UP,
        )
        return self._loads(*moving)

    def torques_of(self, links: Sequence[int], points: Floats, contact_forces: Floats) -> Floats:
        """The joint torques (T, 29), N·m, from forces on links: J^T f.

        The forces act on P links, each moved by a joint, at points (T, P, 3), m, with (T, P, 3) N,
        world.
        """
        forces = np.zeros_like(self._pos)
        moments = np.zeros_like(self._pos)
        about_pelvis = cross(points.T - self._origin[:, np.newaxis], contact_forces.T)
        for number, link in enumerate(links):
            body = self._robot.links.index(link)
            forces[:, body] += contact_forces.T[:, number]
            moments[:, body] += about_pelvis[:, number]
        return self._transmitted(forces, moments)

    @cached_property
    def _at_rest(self) -> tuple[Floats, Floats]:
        """Forces and moments of the bodies while the pelvis rests, without gravity."""
        still = np.zeros_like(self._upright)
        return self._moving(still, still, still)

    def _moving(self, ang_vel: Floats, ang_acc: Floats, acc: Floats) -> tuple[Floats, Floats]:
        """Forces (3, B, T), N, and moments, N·m, that move the bodies; arguments are (3, T)."""
        parents, masses = self._robot.parents, self._robot.masses
        ang_vel = self._outward(ang_vel, self._joint_ang_vel)
        above = ang_vel[:, parents]
        ang_acc = self._outward(ang_acc, self._joint_ang_acc + cross(above, self._joint_ang_vel))
        acc = self._outward(acc, _swing(above, ang_acc[:, parents], self._from_parent))
        forces = masses * (acc + _swing(ang_vel, ang_acc, self._to_centre))
        moments = _times(self._inertia, ang_acc) + cross(ang_vel, _times(self._inertia, ang_vel))
        return forces, moments + cross(self._centre, forces)

    def _held(self, acc: Floats, ang_acc: Floats | None = None) -> tuple[Floats, Floats]:
        """The same for a pelvis that starts to move, (3, T)."""
        (forces, moments), more = self._at_rest, acc[:, np.newaxis]
        if ang_acc is not None:
            turning = np.repeat(ang_acc[:, np.newaxis], len(self._robot.masses), axis=1)
            more = more + cross(turning, self._centre)
            moments = moments + _times(self._inertia, turning)
        more = self._robot.masses * more
        return forces + more, moments + cross(self._centre, more)

    def _outward(self, first: Floats, own: Floats) -> Floats:
        """Sums from the pelvis to each body: (3, T) for it and (3, B - 1, T) for the others."""
        total: Floats = np.concatenate([first[:, np.newaxis], own], axis=1)
        for body, parent in enumerate(self._robot.parents, start=1):
            total[:, body] += total[:, parent]
        return total

    def _loads(self, forces: Floats, moments: Floats) -> BatchLoads:
        """Loads of joints and pelvis from the forces and moments of the bodies (3, B, T)."""
        tau = self._transmitted(forces, moments) + self._rotor_torque
        return BatchLoads(tau, forces[:, 0].T, moments[:, 0].T)

    def _transmitted(self, forces: Floats, moments: Floats) -> Floats:
        """Torques (T, 29) of the joints on the bodies; sums the loads that each body carries."""
        for body in range(len(self._robot.parents), 0, -1):
            parent = self._robot.parents[body - 1]
            forces[:, parent] += forces[:, body]
            moments[:, parent] += moments[:, body]
        about_joint = moments[:, 1:] - cross(self._pos[:, 1:], forces[:, 1:])
        tau = np.zeros((forces.shape[2], N_JOINTS))
        tau[:, self._robot.joints] = (self._axes * about_joint).sum(axis=0).T
        return tau


def _times(matrix: Floats, vector: Floats) -> Floats:
    """Products (3, ...) of matrices (3, 3, ...) and vectors."""
    product: Floats = np.einsum("ij...,j...->i...", matrix, vector)
    return product


def _product(matrix: Floats, other: Floats) -> Floats:
    """Products of matrices (3, 3, ...)."""
    product: Floats = np.einsum("ij...,jk...->ik...", matrix, other)
    return product


def cross(a: Floats, b: Floats) -> Floats:
    """Cross products of vectors (3, ...)."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.multiply(a[j], b[k], out=product[i])
        product[i] -= a[k] * b[j]
    return product


def _swing(ang_vel: Floats, ang_acc: Floats, lever: Floats) -> Floats:
    """The acceleration (3, ...) of a lever's end relative to its start."""
    return cross(ang_acc, lever) + cross(ang_vel, cross(ang_vel, lever))


def _of_points(masses: Floats, places: Floats) -> Floats:
    """The inertia (3, 3, ...) of B masses (B, ...) at places (3, B, ...)."""
    squares = (masses * (places**2).sum(axis=0)).sum(axis=0)
    products = (masses * places[:, np.newaxis] * places).sum(axis=2)
    inertia: Floats = np.multiply.outer(np.eye(3), squares) - products
    return inertia
