"""Bridge between a simulated robot and the DDS topics of the real one, in real time."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final, Protocol

from g1stream.dds.discovery import AnnouncedBridge
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE, SECONDARY_IMU, SPORTMODESTATE

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.clock import Clock
    from g1stream.dds.domain import Participant
    from g1stream.sim.robot import SimReport, SimulatedRobot
    from g1stream.sim.world import Root
    from g1stream.types import Support

__all__ = ["Bridge"]

_CATCH_UP: Final = 50_000_000  # ns
_VIEW_PERIOD: Final = 20_000_000  # ns


class Onboard(Protocol):
    """The robot's own controller on DDS."""

    def step(self, low_state: bytes, stamp: int) -> None:
        """Act after the robot has published a LowState at `stamp`, ns."""

    def stance(self, now: int) -> Root | None:
        """Base pose at `now`, ns, of a robot that the controller balances; None if it does not."""


class Bridge:
    """Runs a simulated G1 on DDS.

    Args:
        participant: a participant in the domain.
        robot: the simulated robot.
        support: how the robot is held, which is announced to streams.
        clock: provides now, stamp and sleep_until.
        onboard: its motion service and its own controller, if it has them.
        view: shows the world, called about 50 times a second; returning False ends the run.
    """

    def __init__(
        self,
        participant: Participant,
        robot: SimulatedRobot,
        support: Support,
        clock: Clock,
        *,
        onboard: Onboard | None = None,
        view: Callable[[], bool] | None = None,
    ) -> None:
        self._robot = robot
        self._clock = clock
        self._view = view
        self._commands = RawReader(participant, LOWCMD)
        self._references = RawReader(participant, REFERENCE)
        announced = AnnouncedBridge(support, robot.model, 1e9 / robot.period)
        self._low_state = RawWriter(participant, LOWSTATE, user_data=announced.user_data)
        self._sport_mode_state = RawWriter(participant, SPORTMODESTATE)
        self._secondary_imu = RawWriter(participant, SECONDARY_IMU)
        self._onboard = onboard

    def run(self, should_stop: Callable[[], bool]) -> SimReport:
        """Simulate until `should_stop` returns True.

        Args:
            should_stop: called at every LowState.

        Raises:
            SimError: the state can no longer be integrated.
        """
        robot = self._robot
        start = due = shown = self._clock.now()
        while not should_stop():
            self._clock.sleep_until(due)
            now = self._clock.now()
            # Publish first, because the state is that of this instant.
            self._publish()
            self._receive(now)
            robot.step(now)
            if self._view and now - shown >= _VIEW_PERIOD:
                shown = now
                if not self._view():
                    break
            due += robot.period
            # A short delay is caught up at once, so that simulated time equals wall time. Catching
            # up a longer one would block the robot's messages meanwhile.
            if (late := now - due) > _CATCH_UP:
                due = now
                robot.report.behind += late / 1e9
                robot.log(logging.WARNING, "the simulation is slower than real time", now)
        robot.report.elapsed = (self._clock.now() - start) / 1e9
        return robot.report

    def _publish(self) -> None:
        published = self._robot.publish()
        stamp = self._clock.stamp()  # the same for all measurements of one instant
        self._low_state.write(published.low_state, stamp)
        self._sport_mode_state.write(published.sport_mode_state, stamp)
        self._secondary_imu.write(published.secondary_imu, stamp)
        if self._onboard:
            self._onboard.step(published.low_state, stamp)

    def _receive(self, now: int) -> None:
        command = self._commands.take_latest()
        if command is not None:
            self._robot.receive_command(command.data, now)
        reference = self._references.take_latest()
        stance = self._onboard.stance(now) if self._onboard else None
        if stance is not None:
            self._robot.set_base(stance)
        elif reference is not None:
            self._robot.receive_reference(reference.data)
