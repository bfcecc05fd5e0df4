"""A simulated robot in step with the loop that commands it: no wire, and no clock but its own.

A run comes out the same to the last bit every time, and as fast as the computer goes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from g1stream.dds.messages import LowCmd, LowState, Reference
from g1stream.sim.bridge import fill_low_state, root_of
from g1stream.sim.world import MotorCommand

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.sim.world import World, WorldState
    from g1stream.types import Support

__all__ = ["Lockstep"]


class Lockstep:
    """Clock and link of a loop at once: while the loop sleeps, the bridge and its robot live.

    The bridge works as the one on DDS does, at the same period. Its ticks come between those of
    the loop, `lag` after them.

    Args:
        world: the simulated robot.
        support: what holds it, as the loop is told.
        period: ns between two LowStates.
        lag: ns from a command to the bridge's tick that obeys it.
        on_state: is given each state and the time of its LowState, ns.
        distort: may change a LowState before it is received, as noise does.
    """

    def __init__(
        self,
        world: World,
        support: Support | None,
        *,
        period: int = 2_000_000,
        lag: int = 1_000_000,
        on_state: Callable[[int, WorldState], None] = lambda time, state: None,
        distort: Callable[[LowState], None] = lambda state: None,
    ) -> None:
        self._world = world
        self._support = support
        self._period = period
        self._steps = max(1, round(period / 1e9 / world.timestep))
        self._on_state = on_state
        self._distort = distort
        self._now = 0
        self._due = lag
        self._command, self._reference, self._state = LowCmd(), Reference(), LowState()
        self._motors = MotorCommand.off()
        self._fresh = False

    def now(self) -> int:
        """Simulated time, ns."""
        return self._now

    def stamp(self) -> int:
        """Simulated time, ns; never 0, which would mean that nothing was published."""
        return self._now + 1

    def sleep_until(self, deadline: int) -> None:
        """Let the bridge do all its ticks before the deadline."""
        while self._due < deadline:
            self._tick()
        self._now = max(self._now, deadline)

    def _tick(self) -> None:
        state = self._world.state()
        fill_low_state(self._state, state, self._motors)
        self._distort(self._state)
        self._on_state(self._due, state)
        self._fresh = True
        for _ in range(self._steps):
            self._world.step(self._motors)
        self._due += self._period

    def listeners(self) -> int:
        """The bridge is always there."""
        return 1

    def rivals(self) -> list[str]:
        """Nobody else is."""
        return []

    def support(self) -> str | None:
        """What holds the robot, as given."""
        return self._support

    def receive(self, state: LowState) -> bool:
        """Load the newest LowState since the last call; False where none came."""
        if self._fresh:
            state.load(self._state.tobytes())
        fresh, self._fresh = self._fresh, False
        return fresh

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Take over a command and the reference beside it, at once."""
        del stamp
        self._command.load(command)
        self._reference.load(reference)
        one = self._command
        self._motors = MotorCommand(
            one.motor_mode == 1,
            *(part.copy() for part in (one.q, one.dq, one.tau, one.kp, one.kd)),
        )
        self._world.lead(root_of(self._reference))
        return self.now()

    def tell(self, level: int, text: str) -> None:
        """Events stay with the loop."""
