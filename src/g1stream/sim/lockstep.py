"""A simulated robot in lockstep with the loop that commands it, without DDS and wall clock.

A run is deterministic to the byte, and as fast as the computer allows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.dds.messages import LOWCMD, LOWSTATE, POLICY, REFERENCE, SECONDARY_IMU, SPORTMODESTATE

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.dds.messages import LowState, Topic
    from g1stream.sim.robot import SimulatedRobot
    from g1stream.types import Support

__all__ = ["EPOCH", "Lockstep"]

EPOCH: Final = 946_684_800_000_000_000
"""Publish time at simulated time 0, ns: 2000-01-01 00:00 UTC, so that it cannot be a real time."""

_LAG: Final = 1_000_000  # time from a command to the robot's tick that uses it, ns


class Lockstep:
    """Clock and link of a loop in one object; the simulated robot advances while the loop sleeps.

    The robot works as on DDS, with the same period. Its ticks are 1 ms after those of the loop.

    Args:
        robot: the simulated robot.
        support: the support that the robot announces to the loop, with its name; None: neither.
        on_sample: called with every published sample of both sides: its topic, bytes and publish
            time, ns.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        support: Support | None,
        *,
        on_sample: Callable[[Topic, bytes, int], None] = lambda topic, data, stamp: None,
    ) -> None:
        self._robot = robot
        self._support = support
        self._on_sample = on_sample
        self._now = 0
        self._due = _LAG
        self._low_state, self._published = b"", 0
        self._command = self._reference = b""

    def now(self) -> int:
        return self._now

    def stamp(self) -> int:
        return EPOCH + self._now

    def sleep_until(self, deadline: int) -> None:
        while self._due < deadline:
            self._now = self._due
            self._tick()
            self._due += self._robot.period
        self._now = max(self._now, deadline)

    def _tick(self) -> None:
        published, stamp = self._robot.publish(), self.stamp()
        self._low_state, self._published = published.low_state, stamp
        for topic, data in zip((LOWSTATE, SPORTMODESTATE, SECONDARY_IMU), published, strict=True):
            self._on_sample(topic, data, stamp)
        if self._command:
            self._robot.receive_command(self._command, self._now)
            self._robot.receive_reference(self._reference)
            self._command = b""
        self._robot.step(self._now)

    def other_publishers(self) -> list[str]:
        return []

    def announced(self) -> tuple[str | None, str | None]:
        return self._support, self._robot.model if self._support else None

    def receive(self, state: LowState) -> int | None:
        data, self._low_state = self._low_state, b""
        if not data:
            return None
        state.load(data)
        state.published, state.received = self._published, self.stamp()
        return 1

    def state_publishers(self) -> list[str]:
        return []

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        self._command, self._reference = command, reference
        self._on_sample(LOWCMD, command, stamp)
        self._on_sample(REFERENCE, reference, stamp)
        return self._now

    def send_step(self, data: bytes, stamp: int) -> None:
        self._on_sample(POLICY, data, stamp)

    def unready(self) -> str:
        return ""

    def replaced(self) -> str:
        return ""
