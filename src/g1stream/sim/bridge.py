"""Puts a simulated world on the topics of the real robot, in step with the clock on the wall."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from g1stream.dds.announcement import user_data_of_support
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import Log, LowCmd, LowState, Reference, SecondaryImu, SportModeState
from g1stream.dds.topics import LOG, LOWCMD, LOWSTATE, REFERENCE, SECONDARY_IMU, SPORTMODESTATE
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.rotations import quat_to_rpy
from g1stream.sim.supports import Root
from g1stream.sim.world import MotorCommand
from g1stream.types import INFO, WARNING, Phase

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.clock import Clock
    from g1stream.config import SimConfig
    from g1stream.dds.domain import Participant
    from g1stream.sim.world import Imu, World, WorldState

__all__ = ["Bridge", "BridgeReport", "fill_low_state", "root_of"]

MODE_MACHINE_29 = 5
"""What LowState says of a G1 with 29 joints, and what a LowCmd for it must echo."""

_TIMEOUT_KD = 3.0
_TELL_PERIOD = 1_000_000_000
_CATCH_UP = 50_000_000
_VIEW_PERIOD = 20_000_000


@dataclass
class BridgeReport:
    """What a bridge did.

    Attributes:
        states: LowStates published.
        commands: LowCmds obeyed, of those that were the newest at a tick.
        refused: why LowCmds were not obeyed -> how many.
        timeouts: how often commands stopped coming.
        simulated: s of simulated time.
        elapsed: s of wall time.
        behind: s that the simulation gave up, because it could not keep up with the wall.
    """

    states: int = 0
    commands: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    timeouts: int = 0
    simulated: float = 0.0
    elapsed: float = 0.0
    behind: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """The report as JSON values."""
        return {**vars(self), "refused": dict(self.refused)}


class Bridge:
    """A simulated G1 on DDS.

    It obeys a LowCmd as strictly as the robot does: the checksum must be right, `mode_machine` must
    be its own, ankles and waist must be meant as pitch and roll, numbers must be finite, and only
    motors that are enabled move.

    Args:
        participant: the domain to be on.
        world: the simulated robot.
        config: rates and timeouts.
        clock: now and sleep_until.
        on_event: is told what is worth telling, (level, text).
        view: shows the world, called some 50 times a second; False ends the run.
    """

    def __init__(
        self,
        participant: Participant,
        world: World,
        config: SimConfig,
        clock: Clock,
        *,
        on_event: Callable[[int, str], None],
        view: Callable[[], bool] | None = None,
    ) -> None:
        self._world = world
        self._clock = clock
        self._on_event = on_event
        self._view = view
        self._period = round(1e9 / config.rate)
        self._steps = max(1, round(self._period / 1e9 / world.timestep))
        self._timeout = round(config.command_timeout * 1e9)
        self._commands = RawReader(participant, LOWCMD)
        support = user_data_of_support(config.support)
        self._references = RawReader(participant, REFERENCE)
        self._reference = Reference()
        self._states = RawWriter(participant, LOWSTATE, user_data=support)
        self._sport = RawWriter(participant, SPORTMODESTATE)
        self._torso = RawWriter(participant, SECONDARY_IMU)
        self._log = RawWriter(participant, LOG, depth=100)
        self._low_cmd, self._low_state = LowCmd(), LowState()
        self._sport_state, self._torso_imu = SportModeState(), SecondaryImu()
        self._message = Log()
        self._message.name = "sim"
        self._motors = MotorCommand.off()
        self._obeyed_at: int | None = None
        self._told_at: dict[str, int] = {}
        self.report = BridgeReport()

    def run(self, should_stop: Callable[[], bool]) -> BridgeReport:
        """Simulate until told to stop.

        Args:
            should_stop: asked at every LowState.

        Raises:
            SimError: the state can no longer be integrated.
        """
        start = due = shown = self._clock.now()
        while not should_stop():
            self._clock.sleep_until(due)
            now = self._clock.now()
            # The state is of this very instant: what is simulated next lies in the future.
            self._publish(self._world.state())
            self._take_command(now)
            self._take_reference()
            for _ in range(self._steps):
                self._world.step(self._motors)
            if self._view and now - shown >= _VIEW_PERIOD:
                shown = now
                if not self._view():
                    break
            due += self._period
            due += self._give_up(now - due)
        self.report.elapsed = (self._clock.now() - start) / 1e9
        self.report.simulated = float(self._world.data.time)
        return self.report

    def _give_up(self, late: int) -> int:
        """How much of the time it is late the simulation does not make up for, ns.

        A little is caught up at once, so that simulated time is wall time; more would freeze the
        robot's answers for as long as the catching up takes.
        """
        if late <= _CATCH_UP:
            return 0
        self.report.behind += late / 1e9
        self._tell(WARNING, "the simulation cannot keep up with the clock on the wall")
        return late

    def _take_command(self, now: int) -> None:
        sample = self._commands.take_latest()
        if sample is not None:
            self._low_cmd.load(sample.data)
            refusal = self._refusal()
            if refusal:
                self.report.refused[refusal] += 1
                self._tell(WARNING, f"LowCmd refused: {refusal}", now)
            else:
                self._obey(now)
        if self._obeyed_at is not None and 0 < self._timeout < now - self._obeyed_at:
            self._obeyed_at = None
            self.report.timeouts += 1
            self._motors = MotorCommand.off()._replace(
                enabled=self._motors.enabled, kd=np.full(N_JOINTS, _TIMEOUT_KD)
            )
            self._tell(WARNING, "no LowCmd any more: the motors only damp", now)

    def _take_reference(self) -> None:
        sample = self._references.take_latest()
        if sample is not None:
            self._reference.load(sample.data)
            self._world.lead(root_of(self._reference))

    def _refusal(self) -> str:
        command = self._low_cmd
        if not command.crc_matches():
            return "its checksum is wrong"
        if int(command.mode_pr) != 0:
            return f"mode_pr is {int(command.mode_pr)}, only 0 (pitch and roll) is simulated"
        if int(command.mode_machine) != MODE_MACHINE_29:
            return f"mode_machine is {int(command.mode_machine)} instead of {MODE_MACHINE_29}"
        numbers = (command.q, command.dq, command.tau, command.kp, command.kd)
        if not all(np.isfinite(values).all() for values in numbers):
            return "it holds a number that is not finite"
        return ""

    def _obey(self, now: int) -> None:
        command = self._low_cmd
        enabled = command.motor_mode == 1
        if not enabled.all():
            off = int(N_JOINTS - enabled.sum())
            self._tell(WARNING, f"{off} of {N_JOINTS} motors are not enabled (mode 0)", now)
        if self._obeyed_at is None:
            self._tell(INFO, "obeying LowCmd", now)
        self._obeyed_at = now
        self.report.commands += 1
        self._motors = MotorCommand(
            enabled,
            command.q.copy(),
            command.dq.copy(),
            command.tau.copy(),
            command.kp.copy(),
            command.kd.copy(),
        )

    def _publish(self, state: WorldState) -> None:
        message = self._low_state
        fill_low_state(message, state, self._motors)
        _fill_imu(self._torso_imu, state.torso_imu)
        sport = self._sport_state
        sport.sec[()], sport.nanosec[()] = divmod(round(state.time * 1e9), 1_000_000_000)
        sport.position[:], sport.velocity[:] = state.base_pos, state.base_lin_vel
        sport.quaternion[:] = state.imu.quat_wxyz
        # One stamp for what was measured at one instant.
        stamp = self._clock.stamp()
        self._states.write(message.seal(), stamp)
        self._sport.write(sport.tobytes(), stamp)
        self._torso.write(self._torso_imu.tobytes(), stamp)
        self.report.states += 1

    def _tell(self, level: int, text: str, now: int | None = None) -> None:
        """Tell an event, the same one at most once a second."""
        now = self._clock.now() if now is None else now
        if now - self._told_at.get(text, -_TELL_PERIOD) < _TELL_PERIOD:
            return
        self._told_at[text] = now
        self._on_event(level, text)
        self._message.level[()] = level
        self._message.text = text
        self._log.write(self._message.tobytes(), self._clock.stamp())


def fill_low_state(message: LowState, state: WorldState, motors: MotorCommand) -> None:
    """Say in a LowState what is measured, and which motors are enabled."""
    message.tick[()] = round(state.time * 1000)
    message.mode_machine[()] = MODE_MACHINE_29
    message.motor_mode = motors.enabled.astype(np.uint8)
    message.q[:], message.dq[:], message.ddq[:] = state.q, state.dq, state.ddq
    message.tau_est[:] = state.tau_est
    _fill_imu(message, state.imu)


def root_of(reference: Reference) -> Root:
    """Where a reference wants the base. Numbers that are not finite end the simulation."""
    return Root(
        reference.root_pos,
        reference.root_quat_wxyz,
        reference.root_lin_vel,
        reference.root_ang_vel,
        playing=int(reference.phase) >= Phase.PLAY,
    )


def _fill_imu(message: LowState | SecondaryImu, imu: Imu) -> None:
    message.quaternion[:] = imu.quat_wxyz
    message.gyroscope[:] = imu.gyroscope
    message.accelerometer[:] = imu.accelerometer
    message.rpy[:] = quat_to_rpy(imu.quat_wxyz)
