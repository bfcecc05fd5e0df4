"""A simulated robot with the messages of the real one, without DDS and clock."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.dds.messages import LowCmd, LowState, Reference, SecondaryImu, SportModeState
from g1stream.events import LOWCMD_TIMEOUT
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.rotations import quat_normalize, quat_to_rpy
from g1stream.sim.world import MotorCommand, Root
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from g1stream.config import SimConfig
    from g1stream.dds.messages import LowState
    from g1stream.sim.world import Imu, World

__all__ = ["MODE_MACHINE_29", "Published", "SensorNoise", "SimReport", "SimulatedRobot"]

_LOGGER = logging.getLogger(__name__)

MODE_MACHINE_29: Final = 5
"""mode_machine of a G1 with 29 joints, in its LowState and in every LowCmd for it."""

#: Time without a LowCmd after which the motors only damp, ns, and their kd, N·m·s/rad.
_TIMEOUT: Final = 500_000_000
_TIMEOUT_KD: Final = 3.0
_LOG_PERIOD: Final = 1_000_000_000  # ns


@dataclass
class SimReport:
    """Counters of a simulated robot.

    Attributes:
        states: number of published LowStates.
        commands: number of accepted LowCmds, counting only the newest one at each tick.
        refused: reason -> number of LowCmds refused for it.
        timeouts: number of LowCmd timeouts.
        simulated, elapsed: simulated and wall time, s.
        behind: wall time that the simulation skipped because it was too slow, s.
    """

    states: int = 0
    commands: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    timeouts: int = 0
    simulated: float = 0.0
    elapsed: float = 0.0
    behind: float = 0.0


class Published(NamedTuple):
    """The samples that the robot publishes at one instant, including the CDR header."""

    low_state: bytes
    sport_mode_state: bytes
    secondary_imu: bytes


class SimulatedRobot:
    """A simulated G1 with the message interface of the robot.

    It checks a LowCmd as strictly as the robot. The CRC must be right, `mode_machine` must be its
    own, ankles and waist must be commanded as pitch and roll, and values must be finite. Only
    enabled motors move. Without a LowCmd for `_TIMEOUT`, its motors
    only damp.

    Args:
        world: the physics.
        config: rate of LowState, command delay (added to that of the world) and timeout, noise.
        mode_machine: mode_machine of the simulated kind of G1.
        noise: may change a LowState before it is published; None: `SensorNoise` with
            `config.noise` and `config.seed`.

    Attributes:
        period: time between two LowStates, ns.
        model: name of the robot.
        report: the counters.
    """

    def __init__(
        self,
        world: World,
        config: SimConfig,
        *,
        mode_machine: int = MODE_MACHINE_29,
        noise: Callable[[LowState], None] | None = None,
    ) -> None:
        self.period = round(1e9 / config.rate)
        self.report = SimReport()
        self.model = world.robot_name
        self._world = world
        self._mode_machine = mode_machine
        self._noise = noise or SensorNoise(config.noise, config.seed)
        self._steps = max(1, round(self.period / 1e9 / world.timestep))
        delay = round((config.command_delay + world.command_delay) * 1e9)
        # In whole periods: a command has waited for half a period on average when it is received.
        self._delay = self.period * int(delay / self.period + 1e-3)  # a period is rounded to ns
        self._arriving: deque[tuple[int, bytes]] = deque()  # commands with their times, ns
        self._low_cmd, self._reference, self._low_state = LowCmd(), Reference(), LowState()
        self._sport_mode_state, self._secondary_imu = SportModeState(), SecondaryImu()
        self._motors = MotorCommand.off()
        self._accepted_at: int | None = None
        self._logged_at: dict[str, int] = {}

    def publish(self) -> Published:
        """Make the samples of the current measurements."""
        state, message = self._world.state(), self._low_state
        message.tick[()] = round(state.time * 1000)
        message.mode_machine[()] = self._mode_machine
        message.motor_mode = self._motors.enabled.astype(np.uint8)
        message.q[:], message.dq[:], message.ddq[:] = state.q, state.dq, state.ddq
        message.tau_est[:] = state.tau_est
        _fill_imu(message, state.imu)
        _fill_imu(self._secondary_imu, state.torso_imu)
        sport = self._sport_mode_state
        sport.sec[()], sport.nanosec[()] = divmod(round(state.time * 1e9), 1_000_000_000)
        sport.position[:], sport.velocity[:] = state.base_pos, state.base_lin_vel
        sport.quaternion[:] = state.imu.quat_wxyz
        self._noise(message)
        self.report.states += 1
        return Published(message.seal(), sport.tobytes(), self._secondary_imu.tobytes())

    def receive_command(self, data: bytes, now: int) -> None:
        """Receive a LowCmd at `now`, ns; it takes effect after the command delay."""
        self._arriving.append((now + self._delay, data))

    def receive_reference(self, data: bytes) -> None:
        """Receive a Reference; values that are not finite end the simulation."""
        reference = self._reference
        reference.load(data)
        self._world.set_reference(
            Root(
                reference.root_pos,
                reference.root_quat_wxyz,
                reference.root_lin_vel,
                reference.root_ang_vel,
                playing=int(reference.phase) >= Phase.PLAY,
            )
        )

    def set_base(self, root: Root) -> None:
        """Pass the base pose of the robot's own controller to the support."""
        self._world.set_reference(root)

    def step(self, now: int) -> None:
        """Simulate one period from `now`, ns.

        Raises:
            SimError: the state can no longer be integrated.
        """
        while self._arriving and self._arriving[0][0] <= now + self.period // 2:
            self._check_command(self._arriving.popleft()[1], now)
        if self._accepted_at is not None and now - self._accepted_at > _TIMEOUT:
            self._accepted_at = None
            self.report.timeouts += 1
            # A stream ends in DAMP, without stiffness, so a timeout after that is not a fault.
            level = logging.WARNING if self._motors.kp.any() else logging.INFO
            self._motors = MotorCommand.off()._replace(
                enabled=self._motors.enabled, kd=np.full(N_JOINTS, _TIMEOUT_KD)
            )
            self.log(level, f"{LOWCMD_TIMEOUT}: the motors only damp", now)
        self._world.step(self._motors, self._steps)
        self.report.simulated = float(self._world.data.time)

    def log(self, level: int, text: str, now: int) -> None:
        """Log an event at `now`, ns; the same text at most once a second."""
        if now - self._logged_at.get(text, -_LOG_PERIOD) >= _LOG_PERIOD:
            self._logged_at[text] = now
            _LOGGER.log(level, text)

    def _check_command(self, data: bytes, now: int) -> None:
        command = self._low_cmd
        command.load(data)
        values = np.array((command.q, command.dq, command.tau, command.kp, command.kd))
        if refusal := self._refusal(values):
            self.report.refused[refusal] = self.report.refused.get(refusal, 0) + 1
            self.log(logging.WARNING, f"LowCmd refused: {refusal}", now)
            return
        present = self._world.present
        enabled = (command.motor_mode == 1) & present
        n = np.count_nonzero(present)
        if off := n - np.count_nonzero(enabled):
            self.log(logging.WARNING, f"motors not enabled (mode 0): {off} of {n}", now)
        if self._accepted_at is None:
            self.log(logging.INFO, "LowCmd accepted", now)
        self._accepted_at = now
        self.report.commands += 1
        self._motors = MotorCommand(enabled, *values)

    def _refusal(self, values: NDArray[np.float32]) -> str:
        command = self._low_cmd
        if not command.crc_matches():
            return "its CRC is wrong"
        if int(command.mode_pr) != 0:
            return f"mode_pr is {int(command.mode_pr)}, only 0 (pitch and roll) is simulated"
        if int(command.mode_machine) != self._mode_machine:
            return f"mode_machine is {int(command.mode_machine)} instead of {self._mode_machine}"
        if not np.isfinite(values).all():
            return "a value is not finite"
        return ""


def _fill_imu(message: LowState | SecondaryImu, imu: Imu) -> None:
    message.quaternion[:] = imu.quat_wxyz
    message.gyroscope[:] = imu.gyroscope
    message.accelerometer[:] = imu.accelerometer
    message.rpy[:] = quat_to_rpy(imu.quat_wxyz)


#: Assumed standard deviations of joint positions, rad, joint speeds, rad/s, gyroscope, rad/s,
#: accelerometer, m/s², and attitude about each axis, rad; not measured on a robot.
_POSITION: Final = 5e-4
_SPEED: Final = 0.05
_GYROSCOPE: Final = 0.01
_ACCELEROMETER: Final = 0.1
_ATTITUDE: Final = 1e-3


class SensorNoise:
    """Adds white noise to the joint positions, joint speeds and IMU of a LowState.

    Args:
        scale: factor of the standard deviations, see the setting `sim.noise`; 0: no noise.
        seed: seed of the random numbers; the same seed gives the same noise.
    """

    def __init__(self, scale: float = 1.0, seed: int = 0) -> None:
        self._scale = scale
        self._rng = np.random.default_rng(seed)

    def __call__(self, state: LowState) -> None:
        """Add noise to a LowState in place."""
        if not self._scale:
            return
        normal, scale = self._rng.normal, self._scale
        state.q[:] += normal(0.0, scale * _POSITION, N_JOINTS)
        state.dq[:] += normal(0.0, scale * _SPEED, N_JOINTS)
        state.gyroscope[:] += normal(0.0, scale * _GYROSCOPE, 3)
        state.accelerometer[:] += normal(0.0, scale * _ACCELEROMETER, 3)
        state.quaternion[:] = quat_normalize(
            state.quaternion + normal(0.0, 0.5 * scale * _ATTITUDE, 4)
        )
        state.rpy[:] = quat_to_rpy(state.quaternion.astype(np.float64))
