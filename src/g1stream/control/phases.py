"""The phases of a session, as a pure state machine.

    WAIT ──> RAMP ──> PLAY ──> HOLD ──> DAMP ──> DONE
      │        └────────┴────────┴───────^         ^
      └────────────────────────────────────────────┘  (nothing was commanded yet)

Whatever ends a session after its first command, an error, a signal or a watchdog, passes through
DAMP. Time comes in as an argument, in integer nanoseconds of one monotonic clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from g1stream.types import Phase

__all__ = ["Inputs", "PhaseState", "Timing", "step"]


@dataclass(frozen=True)
class Timing:
    """How long each phase lasts, ns; `play` is None for a motion that loops."""

    wait: int
    ramp: int
    play: int | None
    hold: int
    damp: int


@dataclass(frozen=True)
class Inputs:
    """What the world says at a tick.

    Attributes:
        ready: a LowState has come and somebody reads LowCmd.
        missing: what did not come, for the reason of a wait in vain.
        stop: why the session must end now; empty while it may go on.
    """

    ready: bool = False
    stop: str = ""
    missing: str = "nobody answered"


@dataclass(frozen=True)
class PhaseState:
    """The phase, the instant it began (ns), and why the session ends ("" while it goes well)."""

    phase: Phase
    since: int
    reason: str = ""

    def elapsed(self, now: int) -> int:
        """Time since the phase began, ns."""
        return now - self.since


def step(now: int, state: PhaseState, inputs: Inputs, timing: Timing) -> PhaseState:
    """The state at `now`.

    A phase that ends by time ends at its exact instant and the next begins there, so that a tick
    that comes late shifts nothing. Several short phases may pass in one step, but DAMP begins at
    `now`: it lasts its whole time however late the tick that begins it.
    """
    if inputs.stop and state.phase < Phase.DAMP:
        after = Phase.DONE if state.phase is Phase.WAIT else Phase.DAMP
        return PhaseState(after, now, inputs.stop)
    if state.phase is Phase.WAIT:
        return _leave_wait(now, state, inputs, timing)
    while (end := _end_of(state, timing)) is not None and now >= end:
        following = Phase(state.phase + 1)
        state = replace(state, phase=following, since=now if following is Phase.DAMP else end)
    return state


def _leave_wait(now: int, state: PhaseState, inputs: Inputs, timing: Timing) -> PhaseState:
    if inputs.ready:
        return PhaseState(Phase.RAMP, now)
    if state.elapsed(now) >= timing.wait:
        return PhaseState(Phase.DONE, now, f"{inputs.missing} within {timing.wait / 1e9:g} s")
    return state


def _end_of(state: PhaseState, timing: Timing) -> int | None:
    lasts = {
        Phase.RAMP: timing.ramp,
        Phase.PLAY: timing.play,
        Phase.HOLD: timing.hold,
        Phase.DAMP: timing.damp,
    }.get(state.phase)
    return None if lasts is None else state.since + lasts
