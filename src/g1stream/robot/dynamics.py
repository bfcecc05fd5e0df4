"""The robot's MuJoCo model, and its inverse dynamics for each way to hold the robot.

A robot whose base floats obeys, with a = (base's acceleration, joints' acceleration),

    M(q) a + h(q, v) = (0, tau - friction) + J(q)^T f

(R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapters 3.1 and 9). M is the inertia, the
rotors' included, h holds gravity, centrifugal and Coriolis terms, and f is the external force that
holds the robot, at a point of Jacobian J. The joints' acceleration is that of the reference; no
motor acts on the first six rows. The support closes the system:

- bolted: the base's acceleration is zero, and the six rows give the force on the bolts;
- follow: the base's acceleration is prescribed, and the six rows give the force that drives it;
- hanging: f acts at a link, the weight straight up unless the force is known; the six rows give the
  base's acceleration;
- free: f is zero, which is flight; the six rows give the base's acceleration.

The base's linear velocity is no argument: the equations are the same in every frame that moves at a
constant velocity. docs/tracking.md has the derivation.
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
    "centres_of_mass",
    "compiled_dynamics",
    "friction_torque",
    "mujoco_spec",
]

_BASE: Final = 6
_ROOT: Final = 1  # the base, after the world
GRAVITY: Final = 9.81
"""m/s²."""

STICTION_SPEED: Final = 0.05
"""Dry friction reaches its full value at about twice this speed, rad/s; below it may take any."""


class BaseMotion(NamedTuple):
    """Orientation and motion of the pelvis.

    Attributes:
        quat_wxyz: (4,) pelvis to world.
        ang_vel: (3,) rad/s, pelvis frame, as a gyroscope measures it.
        lin_acc: (3,) m/s², of its origin, world, without gravity; for `follow` only.
        ang_acc: (3,) rad/s², time derivative of `ang_vel`; for `follow` only.
    """

    quat_wxyz: Floats
    ang_vel: Floats
    lin_acc: Floats = np.zeros(3)
    ang_acc: Floats = np.zeros(3)


class Solution(NamedTuple):
    """The torques of a movement, and the acceleration of the base or what holds it.

    Attributes:
        tau: (29,) N·m, motor order, friction included.
        lin_acc: (3,) m/s², of the pelvis's origin, world.
        ang_acc: (3,) rad/s², pelvis frame.
        wrench: (6,) what bolts, or what drives the pelvis, exert on it: force, N, world, and moment
            about its origin, N·m, pelvis frame; zero for `hanging` and `free`.
    """

    tau: Floats
    lin_acc: Floats
    ang_acc: Floats
    wrench: Floats = np.zeros(_BASE)


class Momentum(NamedTuple):
    """The motion of the whole robot, independent of the base's linear velocity.

    Attributes:
        angular: (3,) N·m·s, world, about the centre of mass.
        velocity: (3,) m/s, world, of the centre of mass relative to the IMU.
        lever: (3,) m, world, from the centre of mass to the carrier's.
    """

    angular: Floats
    velocity: Floats
    lever: Floats


class InverseDynamics:
    """The inverse dynamics of one robot.

    Args:
        robot: has the URDF.
        carrier: the link that a hanging robot hangs from.
        gravity: m/s², downward.

    Attributes:
        name: of the robot.
        mass: kg, of the whole robot.
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
        """The torques of a movement.

        Args:
            support: how the pelvis is held.
            q: (29,) rad, motor order.
            dq: (29,) rad/s.
            ddq: (29,) rad/s².
            base: of the pelvis; its accelerations are used for `follow` only.
            force: (3,) N, world, on a hanging robot; its weight, upward, if None.
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
        """Set the state in MuJoCo; the base stays at the origin, as nothing depends on it."""
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
        """What the accelerometer in the pelvis measures during a solution.

        The specific force at the IMU: a - g of the pelvis's origin, a' x r and w x (w x r).

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
        """How the whole robot moves, as seen from its IMU.

        Args:
            q: (29,) rad, motor order.
            dq: (29,) rad/s.
            base: of the pelvis, without its accelerations.
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
    """A `mujoco.MjSpec` of the robot's URDF and parameters, with rotors and dry friction.

    Every link is a body with the link's name, and the base is the first body of the world. Meshes
    are left out; the joints of fingers are fixed at zero.

    The caller sets the motors' viscous damping in `dof_damping` of the compiled model: in a spec it
    is a number in MuJoCo 3 and a polynomial in 4, in the model an array in both.

    Args:
        robot: has the URDF.
        floating: give the base a free joint; otherwise it is part of the world.
        shapes: keep the primitive shapes, each with a name.

    Raises:
        ValueError: MuJoCo does not accept the URDF.
        ConfigError: the parameters name a link that it does not have.
    """
    import mujoco

    spec = mujoco.MjSpec.from_string(_simplified(robot, shapes))
    if floating:
        spec.worldbody.first_body().add_freejoint()
    for motor in np.flatnonzero(robot.present):
        joint = spec.joint(JOINT_NAMES[motor])
        joint.armature = robot.parameters.armature[motor]
        joint.frictionloss = robot.parameters.friction[motor]
        joint.actfrclimited = False  # the URDF's effort; the motors have limits of their own
    robot.parameters.apply_to_links(spec)
    return spec


@lru_cache(maxsize=KEPT_ROBOTS)
def _simplified(robot: G1, shapes: bool) -> str:
    """The URDF without meshes, finger joints and, unless wanted, shapes."""
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
    """The model of a robot; not to be changed."""
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


@lru_cache(maxsize=KEPT_ROBOTS)
def centres_of_mass(robot: G1) -> Floats:
    """(L, 3) m, in the link's frame: the centre of mass of each link and of what is fixed to it.

    Simulators that merge the links of fixed joints have these bodies. Zero for a link that is
    fixed to another one.

    Raises:
        RobotError: MuJoCo does not accept the URDF.
    """
    import mujoco

    model = compiled_dynamics(robot, GRAVITY)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    centres = np.zeros((len(robot.link_names), 3))
    for link in np.flatnonzero((robot.joint_of_link >= 0) | (robot.parent < 0)):
        body = model.body(robot.link_names[link]).id
        merged = model.body_weldid == body
        centre = np.average(data.xipos[merged], axis=0, weights=model.body_mass[merged])
        centres[link] = data.xmat[body].reshape(3, 3).T @ (centre - data.xpos[body])
    centres.setflags(write=False)
    return centres


def friction_torque(dq: Floats, parameters: Parameters = NOMINAL) -> Floats:
    """Torque (29,) against damping and dry friction at joint speeds dq (29,) rad/s, N·m.

    Dry friction is smoothed around zero speed, where its direction is unknown.
    """
    dry = parameters.friction * np.tanh(dq / STICTION_SPEED)
    torque: Floats = parameters.damping * dq + dry
    return torque


def _rigid_part(model: Any, link: str) -> tuple[NDArray[np.intp], Floats]:
    """The bodies (B,) fixed to a link, itself included, and their shares (B,) of the mass."""
    bodies = np.flatnonzero(model.body_weldid == model.body_weldid[model.body(link).id])
    return bodies, model.body_mass[bodies] / model.body_mass[bodies].sum()


def _imu_pos(robot: G1) -> Floats:
    """Position (3,) of the IMU in the base; its origin where the URDF has no `imu_in_pelvis`."""
    names = robot.link_names
    link = names.index("imu_in_pelvis") if "imu_in_pelvis" in names else 0
    return robot.origin_pos[link] if robot.parent[link] == 0 else np.zeros(3)
