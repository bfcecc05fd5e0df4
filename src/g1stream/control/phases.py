"""The phases of a session, as a pure state machine.

    WAIT ──> RAMP ──> PLAY ──> HOLD ──> DAMP ──> DONE
      │        └────────┴────────┴───────^         ^
      └────────────────────────────────────────────┘  (before the first command)

Whatever ends a session after its first command, an error, a signal or a watchdog, passes through
DAMP. Time comes in as an argument, in integer nanoseconds of one monotonic clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from g1stream.types import Phase

if TYPE_CHECKING:
    from g1stream.config import StreamConfig

__all__ = ["Inputs", "PhaseState", "Timing", "step"]


@dataclass(frozen=True)
class Timing:
    """Length of each phase, ns.

    Attributes:
        wait: WAIT ends the session after this time.
        ramp, hold, damp: of these phases.
        play: of PLAY; None: until stopped.
        settle: WAIT lasts at least this long, so that other publishers of LowCmd are discovered.
        squat: HOLD lasts longer by this, in which a robot on its feet squats down.
    """

    wait: int
    ramp: int
    play: int | None
    hold: int
    damp: int
    settle: int = 0
    squat: int = 0

    @classmethod
    def from_config(cls, settings: StreamConfig, play: float | None, settle: int) -> Timing:
        """The timing of a config; `play` in s, `settle` in ns."""

        def ns(seconds: float) -> int:
            return round(seconds * 1e9)

        return cls(
            wait=ns(settings.wait),
            ramp=ns(settings.ramp),
            play=None if play is None else ns(play),
            hold=ns(settings.hold),
            damp=ns(settings.damp),
            settle=settle,
        )


@dataclass(frozen=True)
class Inputs:
    """What the state machine is told at a tick.

    Attributes:
        missing: what the first command still waits for; empty if nothing.
        stop: why the session must end now; empty if it may continue.
    """

    missing: str = ""
    stop: str = ""


@dataclass(frozen=True)
class PhaseState:
    """The phase, when it began (ns), and why the session ends early ("" if it does not)."""

    phase: Phase
    since: int
    reason: str = ""

    def elapsed(self, now: int) -> int:
        """Time since the phase began, ns."""
        return now - self.since


def step(now: int, state: PhaseState, inputs: Inputs, timing: Timing) -> PhaseState:
    """The state at `now`.

    A phase with a fixed length ends exactly then, and the next one begins there, so that a late
    tick shifts nothing. Several short phases may pass in one step, but DAMP begins at `now`: it
    lasts its full time however late the tick is.
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
    elapsed = state.elapsed(now)
    if not inputs.missing and elapsed >= timing.settle:
        return PhaseState(Phase.RAMP, now)
    if inputs.missing and elapsed >= timing.wait:
        waited = f"waited for stream.wait = {timing.wait / 1e9:g} s"
        return PhaseState(Phase.DONE, now, f"{inputs.missing} ({waited})")
    return state


def _end_of(state: PhaseState, timing: Timing) -> int | None:
    length = {
        Phase.RAMP: timing.ramp,
        Phase.PLAY: timing.play,
        Phase.HOLD: timing.hold + timing.squat,
        Phase.DAMP: timing.damp,
    }.get(state.phase)
    return None if length is None else state.since + length
