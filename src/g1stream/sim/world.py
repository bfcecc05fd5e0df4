"""A simulated G1: motor commands in, measured state out, one physics step at a time.

Time is simulated, without clocks or DDS, and nothing is random: the same commands give the same
states, bit for bit.
"""

from __future__ import annotations

from functools import partial
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from g1stream.errors import SimError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import quat_rotate_inverse
from g1stream.sim.model import build_model
from g1stream.sim.supports import SUPPORTS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from g1stream.robot.model import G1
    from g1stream.sim.supports import Root
    from g1stream.types import Support

__all__ = ["Imu", "MotorCommand", "World", "WorldState"]


class MotorCommand(NamedTuple):
    """Commands to the motors, (29,) in motor order.

    The torque of a motor is tau + kp (q - measured q) + kd (dq - measured dq).
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
    """What an IMU measures."""

    quat_wxyz: NDArray[np.float64]  # (4,) attitude in the world
    gyroscope: NDArray[np.float64]  # (3,) rad/s, in the IMU's frame
    # (3,) m/s², in the IMU's frame, gravity included: upward 9.81 at rest.
    accelerometer: NDArray[np.float64]

    def copy(self) -> Imu:
        return Imu(*(part.copy() for part in self))


class WorldState(NamedTuple):
    """What is measured after a physics step, joints in motor order; the arrays are copies.

    Positions, velocities and attitudes are those at `time`; accelerations and torques are those of
    the step that led there.
    """

    time: float  # s of simulated time
    q: NDArray[np.float64]  # (29,) rad
    dq: NDArray[np.float64]  # (29,) rad/s
    ddq: NDArray[np.float64]  # (29,) rad/s²
    tau_est: NDArray[np.float64]  # (29,) N·m that the motors applied, limits included
    imu: Imu  # in the pelvis
    torso_imu: Imu
    base_pos: NDArray[np.float64]  # (3,) m, the base's origin in the world
    base_lin_vel: NDArray[np.float64]  # (3,) m/s, of that origin, in the world


class World:
    """A G1 above a floor, its base held by a support, its motors driven by commands.

    Args:
        robot: the G1.
        support: what holds its base.
        joint_pos: (29,) rad, motor order, where the joints start; all zero by default.
        base_height: m, where the base starts; by default as the support prefers.
        self_collision: links collide with each other, see `g1stream.sim.model.build_model`.
        timestep: s. With 1 ms, half the period of LowState at 500 Hz, a dance differs by 0.3 mrad
            RMS from that with a step twenty times finer.

    Attributes:
        model: the `mujoco.MjModel`.
        data: its `mujoco.MjData`, for a viewer.
        timestep: s.
        present: (29,) which joints the robot has; the state of the others is 0.

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
        )
        self.data: Any = mujoco.MjData(self.model)
        self._support = kind(self.model, self.data)
        self._support.place(self._support.height if base_height is None else base_height)
        self.present = robot.present
        self._motors = np.flatnonzero(self.present)
        joints = [self.model.joint(JOINT_NAMES[motor]) for motor in self._motors]
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        if joint_pos is not None:
            places = [joint.qposadr[0] for joint in joints]
            self.data.qpos[places] = np.asarray(joint_pos)[self._motors]
        self._base_pos = self.data.sensor("frame_pos").data
        self._base_lin_vel = self.data.sensor("frame_vel").data
        self._kp, self._kd, self._work, self._control = np.zeros((4, N_JOINTS))
        self._integrate = partial(mujoco.mj_step2, self.model, self.data)
        self._look = partial(mujoco.mj_step1, self.model, self.data)
        self._support.hold()
        mujoco.mj_forward(self.model, self.data)
        self._imu, self._torso_imu = self._find_imu("imu"), self._find_imu("secondary_imu")

    def _find_imu(self, name: str) -> Imu:
        """The arrays of an IMU, which MuJoCo updates in place."""
        quat, gyro, acc = (
            self.data.sensor(f"{name}_{part}").data for part in ("quat", "gyro", "acc")
        )
        site = self.model.sensor(f"{name}_acc").objid[0]
        if not self.model.body_weldid[self.model.site_bodyid[site]]:
            # Fixed to the world, where MuJoCo 3.17 measures no gravity.
            acc = quat_rotate_inverse(quat, -self.model.opt.gravity)
        return Imu(quat, gyro, acc)

    def step(self, command: MotorCommand, steps: int = 1) -> None:
        """Advance by timesteps; torques are clipped at `g1stream.robot.joints.TORQUE_LIMIT`.

        Args:
            command: to the motors, in all of them.
            steps: how many.

        Raises:
            SimError: the command is not finite, or the state can no longer be integrated.
        """
        before = self.data.time
        self._set_motors(command)
        for _ in range(steps):
            self._support.hold()
            # Split where MuJoCo's own step begins, so that the sensors show the state at its end.
            self._integrate()
            self._look()
        if self.data.time <= before:
            raise SimError(
                f"The simulation was reset at {before:.3f} s: its state became too large to "
                "integrate, or the viewer reset it.",
                "Check the masses in the URDF, and gains far above Unitree's.",
            )

    def set_reference(self, root: Root) -> None:
        """Give the support the base pose of the reference."""
        self._support.set_reference(root)

    def _set_motors(self, command: MotorCommand) -> None:
        kp, kd, work, control = self._kp, self._kd, self._work, self._control
        np.multiply(command.kp, command.enabled, out=kp)
        np.multiply(command.kd, command.enabled, out=kd)
        np.multiply(command.tau, command.enabled, out=control)
        np.multiply(kp, command.q, out=work)
        control += work
        np.multiply(kd, command.dq, out=work)
        control += work
        if not isfinite(control.sum()):
            joint = JOINT_NAMES[int(np.flatnonzero(~np.isfinite(control))[0])]
            raise SimError(f"The command to {joint} is not finite.", "Publish finite numbers only.")
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
        """What is measured now."""
        data = self.data
        return WorldState(
            time=data.time,
            q=self._by_motor(data.actuator_length),
            dq=self._by_motor(data.actuator_velocity),
            ddq=self._by_motor(data.qacc[self._dofs]),
            tau_est=self._by_motor(data.actuator_force),
            imu=self._imu.copy(),
            torso_imu=self._torso_imu.copy(),
            base_pos=self._base_pos.copy(),
            base_lin_vel=self._base_lin_vel.copy(),
        )
