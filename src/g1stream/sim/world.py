"""Physics of a simulated G1: takes motor commands, and returns the measured state after each step.

Time is simulated, without clocks or DDS, and pushes depend on their seed only. The same commands
give the same states, bit for bit.
"""

from __future__ import annotations

from functools import partial
from math import inf, isfinite, sqrt
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np

from g1stream.errors import SimError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS, TORQUE_LIMIT
from g1stream.robot.rotations import quat_mul, quat_normalize, quat_rotate_inverse
from g1stream.sim.model import BASE_BODY, BASE_TARGET, build_model

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from g1stream.robot.model import G1
    from g1stream.types import Support

__all__ = [
    "PUSH_PERIOD",
    "SUPPORTS",
    "BaseSupport",
    "Bolted",
    "Follow",
    "Free",
    "Hanging",
    "Imu",
    "MotorCommand",
    "Root",
    "World",
    "WorldState",
]


PUSH_PERIOD: Final = 5.0
"""Simulated time from the release of the base to the first push, and between two pushes, s."""


class MotorCommand(NamedTuple):
    """Commands to the motors, (29,) in motor order.

    The torque of a motor is tau + kp (q - measured q) + kd (dq - measured dq), times the torque
    scale of the robot's parameters.
    """

    enabled: NDArray[np.bool_]  # a motor that is not enabled gives no torque
    q: NDArray[np.floating[Any]]  # rad
    dq: NDArray[np.floating[Any]]  # rad/s
    tau: NDArray[np.floating[Any]]  # N·m
    kp: NDArray[np.floating[Any]]  # N·m/rad
    kd: NDArray[np.floating[Any]]  # N·m·s/rad

    @classmethod
    def off(cls) -> MotorCommand:
        return cls(np.zeros(N_JOINTS, dtype=np.bool_), *np.zeros((5, N_JOINTS)))


class Imu(NamedTuple):
    """A reading of an IMU."""

    quat_wxyz: NDArray[np.float64]  # (4,) attitude in the world
    gyroscope: NDArray[np.float64]  # (3,) rad/s, in the IMU's frame
    # (3,) m/s², in the IMU's frame, including gravity (9.81 upward at rest).
    accelerometer: NDArray[np.float64]

    def copy(self) -> Imu:
        return Imu(self.quat_wxyz.copy(), self.gyroscope.copy(), self.accelerometer.copy())


class WorldState(NamedTuple):
    """Measurements after a physics step, joints in motor order; the arrays are copies.

    Positions, velocities and attitudes are those at `time`. Joint accelerations and torques are
    means over the last `World.step`. Accelerometer readings are those of its last timestep.
    """

    time: float  # s of simulated time
    q: NDArray[np.float64]  # (29,) rad
    dq: NDArray[np.float64]  # (29,) rad/s
    ddq: NDArray[np.float64]  # (29,) rad/s²
    # (29,) applied motor torque after limits, N·m.
    tau_est: NDArray[np.float64]
    imu: Imu  # in the pelvis
    torso_imu: Imu
    base_pos: NDArray[np.float64]  # (3,) position of the base's origin in the world, m
    base_lin_vel: NDArray[np.float64]  # (3,) velocity of that origin in the world, m/s


class World:
    """A G1 above a floor, whose base is held by a support and whose motors follow commands.

    Args:
        robot: the G1.
        support: support of the base.
        joint_pos: (29,) initial joint positions, rad, motor order; None: all zero.
        base_height: initial height of the base, m; None: default of the support.
        self_collision: links collide with each other, see `g1stream.sim.model.build_model`.
        timestep: simulation timestep, s. With 1 ms, half the period of LowState at 500 Hz, a dance
            differs by 0.3 mrad RMS from the result with a timestep of 0.05 ms.
        push: maximum speed that a push adds to the base along x and along y, m/s; 0: no pushes.
            Both are uniformly distributed between this and its negative.
        seed: seed of the pushes.
        visual: with the shapes that only a viewer needs.

    Attributes:
        model: the `mujoco.MjModel`.
        data: its `mujoco.MjData`, for a viewer.
        timestep: simulation timestep, s.
        robot_name: name of the robot.
        present: (29,) the joints that the robot has; the state of the others is 0.
        command_delay: command delay in the robot's parameters, s; the caller applies it.

    Raises:
        SimError: the robot cannot be simulated.
    """

    def __init__(
        self,
        robot: G1,
        support: Support = "bolted",
        *,
        joint_pos: ArrayLike | None = None,
        base_height: float | None = None,
        self_collision: bool = True,
        timestep: float = 1e-3,
        push: float = 0.0,
        seed: int = 0,
        visual: bool = False,
    ) -> None:
        import mujoco

        kind = SUPPORTS[support]
        self.timestep = timestep
        self.model: Any = build_model(
            robot,
            floating=kind.floating,
            driven=kind.driven,
            timestep=timestep,
            self_collision=self_collision,
            visual=visual,
        )
        self.data: Any = mujoco.MjData(self.model)
        self._support = kind(self.model, self.data)
        self._push, self._rng = push, np.random.default_rng(seed)
        self._loose = 0  # timesteps since the base was released
        self._support.place(self._support.height if base_height is None else base_height)
        self.robot_name = robot.name
        self.present = robot.present
        self.command_delay = robot.parameters.command_delay
        self._torque_scale = robot.parameters.torque_scale
        self._motors = np.flatnonzero(self.present)
        joints = [self.model.joint(JOINT_NAMES[motor]) for motor in self._motors]
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._places = np.array([joint.qposadr[0] for joint in joints])
        if joint_pos is not None:
            self.data.qpos[self._places] = np.asarray(joint_pos)[self._motors]
        self._base_pos = self.data.sensor("frame_pos").data
        self._base_lin_vel = self.data.sensor("frame_vel").data
        self._kp, self._kd, self._work, self._control = np.zeros((4, N_JOINTS))
        self._limit = TORQUE_LIMIT[self._motors]
        self._applied, self._acceleration = np.zeros((2, len(self._motors)))
        self._integrate = partial(mujoco.mj_step2, self.model, self.data)
        self._look = partial(mujoco.mj_step1, self.model, self.data)
        self._support.hold()
        mujoco.mj_forward(self.model, self.data)
        self._imus = self._find_imu("imu"), self._find_imu("secondary_imu")

    def _find_imu(self, name: str) -> Imu:
        """The arrays of an IMU, which MuJoCo updates in place, if its body can move."""
        quat, gyro, acc = (
            self.data.sensor(f"{name}_{part}").data for part in ("quat", "gyro", "acc")
        )
        site = self.model.sensor(f"{name}_acc").objid[0]
        if not self.model.body_weldid[self.model.site_bodyid[site]]:
            # MuJoCo 3.17 measures no gravity at a body that is fixed to the world.
            acc = quat_rotate_inverse(quat, -self.model.opt.gravity)
        return Imu(quat, gyro, acc)

    def step(self, command: MotorCommand, steps: int = 1) -> None:
        """Advance by timesteps; torques are clipped at `g1stream.robot.joints.TORQUE_LIMIT`.

        Args:
            command: command to the motors in all timesteps.
            steps: number of timesteps.

        Raises:
            SimError: the command is not finite, or the state can no longer be integrated.
        """
        before = self.data.time
        self._set_motors(command)
        # Damping is implicit, so it uses the velocity at the end of a timestep.
        kd, velocity = self._kd[self._motors], self.data.actuator_velocity
        force, applied = self.data.actuator_force, self._applied
        applied[:] = 0.0
        first = velocity.copy()
        for _ in range(steps):
            earlier = velocity.copy()
            self._support.hold()
            if self._push:
                self._push_when_due()
            # mj_step2 before mj_step1, so that the sensors show the state at the end of the step.
            self._integrate()
            self._look()
            applied += force
            applied -= kd * (velocity - earlier) * (np.abs(force) < self._limit)
        applied /= steps
        self._acceleration = (velocity - first) / (steps * self.timestep)
        if self.data.time <= before:
            raise SimError(
                f"The simulation was reset at {before:.3f} s: its state became too large to "
                "integrate, or the viewer reset it.",
                "Check the masses in the URDF, and whether gains are far above Unitree's.",
            )

    def _push_when_due(self) -> None:
        """Push a base that nothing holds, as in the training of policies."""
        self._loose = self._loose + 1 if self._support.loose else 0
        if self._loose and self._loose % round(PUSH_PERIOD / self.timestep) == 0:
            self._support.push(self._rng.uniform(-self._push, self._push, 2))

    def set_reference(self, root: Root) -> None:
        """Pass the base pose of the reference to the support."""
        self._support.set_reference(root)

    def set_state(self, joint_pos: ArrayLike, joint_vel: ArrayLike, root: Root) -> None:
        """Set the state of the robot, for example to a measured one.

        Args:
            joint_pos: (29,) rad, motor order.
            joint_vel: (29,) rad/s.
            root: state of the base; a bolted base only takes the attitude, a free one is released.
        """
        import mujoco

        self.data.qpos[self._places] = np.asarray(joint_pos)[self._motors]
        self.data.qvel[self._dofs] = np.asarray(joint_vel)[self._motors]
        self.data.qacc_warmstart[:] = 0.0
        self._support.move(root)
        mujoco.mj_forward(self.model, self.data)
        self._imus = self._find_imu("imu"), self._find_imu("secondary_imu")

    def _set_motors(self, command: MotorCommand) -> None:
        kp, kd, work, control = self._kp, self._kd, self._work, self._control
        applied = self._torque_scale * command.enabled
        np.multiply(command.kp, applied, out=kp)
        np.multiply(command.kd, applied, out=kd)
        np.multiply(command.tau, applied, out=control)
        np.multiply(kp, command.q, out=work)
        control += work
        np.multiply(kd, command.dq, out=work)
        control += work
        if not isfinite(control.sum()):
            joint = JOINT_NAMES[int(np.flatnonzero(~np.isfinite(control))[0])]
            raise SimError(f"The command to {joint} is not finite.", "Publish only finite numbers.")
        bias, motors = self.model.actuator_biasprm, self._motors
        self.data.ctrl[:] = control[motors]
        bias[:, 1] = -kp[motors]
        bias[:, 2] = -kd[motors]

    def _by_motor(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(29,) values of the joints that the robot has, and 0 for the others; a copy."""
        found = np.zeros(N_JOINTS)
        found[self._motors] = values
        return found

    def state(self) -> WorldState:
        """The current measurements."""
        data = self.data
        return WorldState(
            time=data.time,
            q=self._by_motor(data.actuator_length),
            dq=self._by_motor(data.actuator_velocity),
            ddq=self._by_motor(self._acceleration),
            tau_est=self._by_motor(self._applied),
            imu=self._imus[0].copy(),
            torso_imu=self._imus[1].copy(),
            base_pos=self._base_pos.copy(),
            base_lin_vel=self._base_lin_vel.copy(),
        )


class Root(NamedTuple):
    """The base pose and velocity of a reference."""

    pos: NDArray[np.float64]  # (3,) m, world
    quat_wxyz: NDArray[np.float64]  # (4,) base to world
    lin_vel: NDArray[np.float64]  # (3,) m/s, world
    ang_vel: NDArray[np.float64]  # (3,) rad/s, base frame
    playing: bool  # whether the motion is being played; False before it


class BaseSupport:
    """Base class of supports of the base, for a compiled model and its data."""

    floating: ClassVar = True  # whether the base needs a free joint
    driven: ClassVar = False  # whether the base is welded to a mocap body
    # Default initial height of the base, m; a straight leg with its foot is 0.8 m long.
    height = 1.0

    def __init__(self, model: Any, data: Any) -> None:
        self._base_pose, self._base_vel = data.qpos[:7], data.qvel[:6]

    def place(self, height: float) -> None:
        """Place the base upright and at rest at x = y = 0 and this height, m."""
        self._base_pose[:] = 0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0
        self._base_vel[:] = 0.0

    def move(self, root: Root) -> None:
        """Set the pose and velocity of the base."""
        self._base_pose[:3], self._base_pose[3:] = root.pos, root.quat_wxyz
        self._base_vel[:3], self._base_vel[3:] = root.lin_vel, root.ang_vel

    def hold(self) -> None:
        """Set the external forces of the next physics step."""

    def set_reference(self, root: Root) -> None:
        """Receive the base pose of a reference."""

    @property
    def loose(self) -> bool:
        """Whether the base is currently released."""
        return False

    def push(self, velocity: NDArray[np.float64]) -> None:
        """Add a velocity (2,) along x and y, m/s, to a released base."""
        self._base_vel[:2] += velocity


class Bolted(BaseSupport):
    """Support whose base is part of the world and never moves."""

    floating = False

    def __init__(self, model: Any, data: Any) -> None:
        self._base_pos, self._base_quat = model.body_pos[BASE_BODY], model.body_quat[BASE_BODY]

    def place(self, height: float) -> None:
        self._base_pos[:] = 0.0, 0.0, height

    def move(self, root: Root) -> None:
        self._base_quat[:] = root.quat_wxyz


class Hanging(BaseSupport):
    """Support with a floating base and an elastic band at the torso, as in unitree_mujoco.

    The band connects the point (0, 0, 3) with the base. Along this line it pulls with 200 N/m times
    its length (the rest length is 0) minus 100 N·s/m times the speed of the base along it. The
    force acts on the centre of mass of the torso and the links fixed to it. Swinging is not damped.
    The base starts at the height at which the band carries the robot's weight.
    """

    _TOP: Final = 3.0
    _STIFFNESS: Final = 200.0
    _DAMPING: Final = 100.0

    def __init__(self, model: Any, data: Any) -> None:
        weight = -model.opt.gravity[2] * model.body_subtreemass[BASE_BODY]
        self.height = float(self._TOP - weight / self._STIFFNESS)
        super().__init__(model, data)
        torso = model.body_weldid == model.body_weldid[model.site("secondary_imu").bodyid[0]]
        # Forces on the torso's bodies in proportion to their masses act on their common centre.
        self._torso = np.flatnonzero(torso)
        self._share = (model.body_mass[torso] / model.body_mass[torso].sum())[:, None]
        self._forces = data.xfrc_applied
        self._force = np.zeros(3)

    def hold(self) -> None:
        x, y, z = self._base_pose[:3].tolist()
        vx, vy, vz = self._base_vel[:3].tolist()
        dx, dy, dz = -x, -y, self._TOP - z
        length = max(sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        speed = (vx * dx + vy * dy + vz * dz) / length
        pull = self._STIFFNESS - self._DAMPING * speed / length
        self._force[:] = pull * dx, pull * dy, pull * dz
        self._forces[self._torso, :3] = self._share * self._force


class Follow(BaseSupport):
    """Support that moves the base along the root pose of the reference.

    The floor has no contacts, because the feet of retargeted motions penetrate it. Before the first
    reference the base stays at its initial pose. At the first reference, and at a jump, the whole
    robot is moved there at once. Without new references the base stops.
    """

    driven = True
    _LEAP: Final = 0.2  # distance of two references that counts as a jump, m
    _TIMEOUT: Final = 0.1  # time without a reference after which the base stops, s

    def __init__(self, model: Any, data: Any) -> None:
        super().__init__(model, data)
        target = model.body_mocapid[model.body(BASE_TARGET).id]
        self._pos, self._quat = data.mocap_pos[target], data.mocap_quat[target]
        self._timestep = model.opt.timestep
        self._vel, self._ang_vel = np.zeros(3), np.zeros(3)
        self._reference_age = inf
        floor = model.geom("floor").id
        model.geom_contype[floor] = model.geom_conaffinity[floor] = 0

    def place(self, height: float) -> None:
        super().place(height)
        self._pos[:], self._quat[:] = self._base_pose[:3], self._base_pose[3:]

    def hold(self) -> None:
        self._reference_age += self._timestep
        if self._reference_age > self._TIMEOUT:
            return
        self._pos += self._timestep * self._vel
        turn = self._timestep * self._ang_vel
        self._quat[:] = quat_normalize(quat_mul(self._quat, np.array([1.0, *(turn / 2)])))

    def set_reference(self, root: Root) -> None:
        first = self._reference_age > self._TIMEOUT
        if first or np.abs(root.pos - self._pos).max() > self._LEAP:
            super().move(root)
        self._pos[:], self._quat[:] = root.pos, root.quat_wxyz
        self._vel[:], self._ang_vel[:] = root.lin_vel, root.ang_vel
        self._reference_age = 0.0

    def move(self, root: Root) -> None:
        super().move(root)
        self.set_reference(root)


class Free(Follow):
    """Support that releases the base when the motion begins, so that the robot stands or falls.

    Before that, and again when another session begins, the base is held at the reference's first
    frame.
    """

    def __init__(self, model: Any, data: Any) -> None:
        floor = model.geom("floor").id
        solid = model.geom_contype[floor], model.geom_conaffinity[floor]
        super().__init__(model, data)
        model.geom_contype[floor], model.geom_conaffinity[floor] = solid
        self._weld = data.eq_active[model.equality(BASE_TARGET).id :][:1]

    @property
    def loose(self) -> bool:
        return not self._weld[0]

    def hold(self) -> None:
        if self._weld[0]:
            super().hold()

    def move(self, root: Root) -> None:
        BaseSupport.move(self, root)
        self._weld[0] = False

    def set_reference(self, root: Root) -> None:
        if root.playing:
            self._weld[0] = False
            return
        if not self._weld[0]:
            self._weld[0] = True
            BaseSupport.move(self, root)
        super().set_reference(root)


SUPPORTS: Final[Mapping[Support, type[BaseSupport]]] = {
    "bolted": Bolted,
    "hanging": Hanging,
    "follow": Follow,
    "free": Free,
}
