"""The robot's MuJoCo model, and its inverse dynamics for each support of the robot.

The equation of motion of a robot with a floating base, with a = (acceleration of the base,
acceleration of the joints), is

    M(q) a + h(q, v) = (0, tau - friction) + J(q)^T f

(R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapters 3.1 and 9). M is the inertia
including the rotors, h are the gravity, centrifugal and Coriolis terms, and f is the external force
that holds the robot, at a point with the Jacobian J. The joint accelerations are those of the
reference. No motor acts on the first six rows. The support determines the remaining unknowns:

- bolted: the acceleration of the base is zero, and the six rows give the force on the bolts;
- follow: the acceleration of the base is given, and the six rows give the force that drives it;
- hanging: f acts at a link, upward with the robot's weight unless the force is known, and the six
  rows give the acceleration of the base;
- free: f is zero (flight), and the six rows give the acceleration of the base.

The linear velocity of the base is not an argument, because the equations are the same in every
frame with a constant velocity. docs/tracking.md has the derivation.
"""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from g1stream.errors import RobotError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.parameters import NOMINAL
from g1stream.robot.rotations import quat_rotate, quat_rotate_inverse
from g1stream.robot.urdf import KEPT_ROBOTS
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.robot.model import G1
    from g1stream.robot.parameters import Parameters
    from g1stream.types import Support

__all__ = [
    "GRAVITY",
    "STICTION_SPEED",
    "BaseMotion",
    "InverseDynamics",
    "Momentum",
    "Solution",
    "compiled_dynamics",
    "friction_torque",
    "mujoco_spec",
]

_BASE: Final = 6
_ROOT: Final = 1  # body of the base, after the world
GRAVITY: Final = 9.81
"""Gravitational acceleration, m/s²."""

STICTION_SPEED: Final = 0.05
"""Joint speed, rad/s, at about twice of which dry friction reaches its full value."""


class BaseMotion(NamedTuple):
    """Orientation and motion of the pelvis.

    Attributes:
        quat_wxyz: (4,) pelvis to world.
        ang_vel: (3,) rad/s, pelvis frame, as measured by a gyroscope.
        lin_acc: (3,) m/s² of its origin, world, without gravity; for `follow` only.
        ang_acc: (3,) rad/s², time derivative of `ang_vel`; for `follow` only.
    """

    quat_wxyz: Floats
    ang_vel: Floats
    lin_acc: Floats = np.zeros(3)
    ang_acc: Floats = np.zeros(3)


class Solution(NamedTuple):
    """Solution of the inverse dynamics: joint torques, and acceleration or wrench of the base.

    Attributes:
        tau: (29,) N·m, motor order, including friction.
        lin_acc: (3,) m/s² of the pelvis's origin, world.
        ang_acc: (3,) rad/s², pelvis frame.
        wrench: (6,) wrench of the support on the pelvis: force, N, world, and moment about the
            origin, N·m, pelvis frame; zero for `hanging` and `free`.
    """

    tau: Floats
    lin_acc: Floats
    ang_acc: Floats
    wrench: Floats = np.zeros(_BASE)


class Momentum(NamedTuple):
    """Momentum of the whole robot, independent of the linear velocity of the base.

    Attributes:
        angular: (3,) angular momentum about the centre of mass, N·m·s, world.
        velocity: (3,) velocity of the centre of mass relative to the IMU, m/s, world.
        lever: (3,) vector from the centre of mass to that of the carrier, m, world.
    """

    angular: Floats
    velocity: Floats
    lever: Floats


class InverseDynamics:
    """The inverse dynamics of one robot.

    Args:
        robot: the robot.
        carrier: the link that a hanging robot hangs from.
        gravity: downward, m/s².

    Attributes:
        name: name of the robot.
        mass: mass of the whole robot, kg.
        gravity: as given.

    Raises:
        RobotError: MuJoCo does not accept the URDF, or there is no link `carrier`.
    """

    def __init__(self, robot: G1, *, carrier: str = "torso_link", gravity: float = GRAVITY) -> None:
        import mujoco

        robot.link_index(carrier)
        model = compiled_dynamics(robot, gravity)
        self._mujoco: Any = mujoco
        self._model: Any = model
        self._data: Any = mujoco.MjData(model)
        self._parameters = robot.parameters
        self._present = np.flatnonzero(robot.present)
        joints = [model.joint(JOINT_NAMES[i]) for i in self._present]
        self._q = np.array([joint.qposadr[0] for joint in joints])
        self._v = np.array([joint.dofadr[0] for joint in joints])
        self._rigid_part = _rigid_part(model, carrier)
        self.name = robot.name
        self.mass = float(model.body_mass.sum())
        self.gravity = gravity
        self._up = np.array([0.0, 0.0, gravity])
        self._imu_pos = _imu_pos(robot)
        self._jacobian = np.zeros((3, model.nv))
        # Views and buffers, so that a tick allocates little.
        self._qpos, self._qvel, self._acc = self._data.qpos, self._data.qvel, self._data.qacc
        self._armature = model.dof_armature.copy()
        self._units, self._columns = np.eye(_BASE, model.nv), np.zeros((_BASE, model.nv))

    def solve(
        self,
        support: Support,
        q: Floats,
        dq: Floats,
        ddq: Floats,
        base: BaseMotion,
        *,
        force: Floats | None = None,
    ) -> Solution:
        """Compute the torques for joint accelerations.

        Args:
            support: how the pelvis is held.
            q: (29,) rad, motor order.
            dq: (29,) rad/s.
            ddq: (29,) rad/s².
            base: motion of the pelvis; its accelerations are used for `follow` only.
            force: (3,) force on a hanging robot, N, world; None: its weight, upward.
        """
        acc, v = self._acc, self._v
        self._place(q, dq, base)
        acc[:_BASE] = 0.0
        acc[v] = ddq[self._present]
        external = self._carried(force) if support == "hanging" else 0.0
        if support == "follow":
            acc[:3], acc[3:_BASE] = base.lin_acc, base.ang_acc
        elif support != "bolted":
            missing = external - self._inverse()
            acc[:_BASE] = np.linalg.solve(self._base_inertia(), missing[:_BASE])
        total = self._inverse() - external
        base_acc = acc[:_BASE].copy()
        tau = np.zeros(N_JOINTS)
        tau[self._present] = total[v] + friction_torque(dq, self._parameters)[self._present]
        return Solution(tau, base_acc[:3], base_acc[3:], total[:_BASE])

    def _place(self, q: Floats, dq: Floats, base: BaseMotion) -> None:
        """Set the state in MuJoCo, with the base at the origin; results do not depend on it."""
        mujoco, model, data = self._mujoco, self._model, self._data
        self._qpos[3:7] = base.quat_wxyz
        self._qpos[self._q] = q[self._present]
        self._qvel[3:_BASE] = base.ang_vel
        self._qvel[self._v] = dq[self._present]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)

    def _inverse(self) -> Floats:
        """The generalised force (35,) of the current state and acceleration, without a support."""
        result = np.empty(self._model.nv)
        self._mujoco.mj_rne(self._model, self._data, 1, result)
        result += self._armature * self._acc  # which mj_rne leaves out
        return result

    def _base_inertia(self) -> Floats:
        """The first six rows and columns of M (6, 6)."""
        self._mujoco.mj_makeM(self._model, self._data)
        for unit, column in zip(self._units, self._columns, strict=True):
            self._mujoco.mj_mulM(self._model, self._data, column, unit)
        return self._columns[:, :_BASE]

    def specific_force(self, solution: Solution, base: BaseMotion) -> Floats:
        """Predict the reading of the accelerometer in the pelvis for a solution.

        This is the specific force at the IMU: a - g of the pelvis's origin, plus a' x r and
        w x (w x r).

        Returns:
            (3,) m/s², pelvis frame.
        """
        lin_acc, ang_acc, ang_vel = solution.lin_acc, solution.ang_acc, base.ang_vel
        upward = quat_rotate_inverse(base.quat_wxyz, lin_acc + self._up)
        (x, y, z), (ax, ay, az) = self._imu_pos.tolist(), ang_acc.tolist()
        swing = np.array([ay * z - az * y, az * x - ax * z, ax * y - ay * x])
        inward = ang_vel * (ang_vel @ self._imu_pos) - self._imu_pos * (ang_vel @ ang_vel)
        measured: Floats = upward + swing + inward
        return measured

    def momentum(self, q: Floats, dq: Floats, base: BaseMotion) -> Momentum:
        """Compute the momentum of the whole robot, relative to its IMU.

        Args:
            q: (29,) rad, motor order.
            dq: (29,) rad/s.
            base: motion of the pelvis; its accelerations are not used.
        """
        data = self._data
        self._place(q, dq, base)
        self._mujoco.mj_subtreeVel(self._model, data)
        bodies, share = self._rigid_part
        (x, y, z), (wx, wy, wz) = self._imu_pos.tolist(), base.ang_vel.tolist()
        imu_vel = np.array([wy * z - wz * y, wz * x - wx * z, wx * y - wy * x])
        return Momentum(
            data.subtree_angmom[_ROOT].copy(),
            data.subtree_linvel[_ROOT] - quat_rotate(base.quat_wxyz, imu_vel),
            share @ data.xipos[bodies] - data.subtree_com[_ROOT],
        )

    def _carried(self, force: Floats | None) -> Floats:
        """The generalised force (35,) of a force at the carrier's centre of mass."""
        bodies, share = self._rigid_part
        centre = share @ self._data.xipos[bodies]
        self._mujoco.mj_jac(self._model, self._data, self._jacobian, None, centre, bodies[0])
        if force is None:
            force = self.mass * self._up
        carried: Floats = force @ self._jacobian
        return carried


def mujoco_spec(robot: G1, *, floating: bool, shapes: bool) -> Any:
    """Make a `mujoco.MjSpec` of the robot's URDF and parameters, with rotors and dry friction.

    Every link is a body with the link's name, and the base is the first body of the world. Meshes
    are left out, and finger joints are fixed at zero.

    The caller sets the motors' viscous damping in `dof_damping` of the compiled model. In a spec it
    is a number in MuJoCo 3 and a polynomial in 4; in the model it is an array in both versions.

    Args:
        robot: the robot.
        floating: give the base a free joint; otherwise it is part of the world.
        shapes: keep the primitive shapes, each with a name.

    Raises:
        ValueError: MuJoCo does not accept the URDF.
        ConfigError: the parameters name a link that the robot does not have.
    """
    import mujoco

    spec = mujoco.MjSpec.from_string(_simplified(robot, shapes))
    if floating:
        spec.worldbody.first_body().add_freejoint()
    for motor in np.flatnonzero(robot.present):
        joint = spec.joint(JOINT_NAMES[motor])
        joint.armature = robot.parameters.armature[motor]
        joint.frictionloss = robot.parameters.friction[motor]
        joint.actfrclimited = False  # the URDF's effort; the motors have their own limits
    robot.parameters.apply_to_links(spec)
    return spec


@lru_cache(maxsize=KEPT_ROBOTS)
def _simplified(robot: G1, shapes: bool) -> str:
    """The URDF without meshes and finger joints, and without shapes unless `shapes` is set."""
    root = deepcopy(robot.xml)
    for settings in root.findall("mujoco"):
        root.remove(settings)
    settings = ET.SubElement(root, "mujoco")
    ET.SubElement(settings, "compiler", discardvisual="false", fusestatic="false")
    for link in root.iter("link"):
        for number, shape in enumerate([*link.iterfind("visual"), *link.iterfind("collision")]):
            if not shapes or shape.find("geometry/mesh") is not None:
                link.remove(shape)
            shape.set("name", f"{link.get('name')}_{number}")
    for joint in root.iter("joint"):
        if joint.get("name") in robot.ignored_joints:
            joint.set("type", "fixed")
    return ET.tostring(root, encoding="unicode")


@lru_cache(maxsize=KEPT_ROBOTS)
def compiled_dynamics(robot: G1, gravity: float) -> Any:
    """The compiled MuJoCo model of a robot; do not change it."""
    import mujoco

    try:
        spec = mujoco_spec(robot, floating=True, shapes=False)
        spec.option.gravity = [0.0, 0.0, -gravity]
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise RobotError(
            f"MuJoCo does not accept the URDF {robot.source}: {' '.join(str(error).split())}.",
            "Correct the URDF; every moving link needs a mass and an inertia.",
        ) from error


def friction_torque(dq: Floats, parameters: Parameters = NOMINAL) -> Floats:
    """Torque (29,), N·m, that overcomes damping and dry friction at joint speeds dq (29,) rad/s.

    Dry friction is smoothed around zero speed, where its direction is unknown.
    """
    dry = parameters.friction * np.tanh(dq / STICTION_SPEED)
    torque: Floats = parameters.damping * dq + dry
    return torque


def _rigid_part(model: Any, link: str) -> tuple[NDArray[np.intp], Floats]:
    """Bodies (B,) fixed to a link, including itself, and their shares (B,) of the mass."""
    bodies = np.flatnonzero(model.body_weldid == model.body_weldid[model.body(link).id])
    return bodies, model.body_mass[bodies] / model.body_mass[bodies].sum()


def _imu_pos(robot: G1) -> Floats:
    """Position (3,) of the IMU in the base, m; zero if the URDF has no `imu_in_pelvis`."""
    names = robot.link_names
    link = names.index("imu_in_pelvis") if "imu_in_pelvis" in names else 0
    return robot.origin_pos[link] if robot.parent[link] == 0 else np.zeros(3)
