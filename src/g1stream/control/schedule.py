"""The phases of a session, and the target at any time. Pure.

    WAIT ──> RAMP ──> PLAY ──> HOLD ──> DAMP ──> DONE
      │        └────────┴────────┴───────^         ^
      └────────────────────────────────────────────┘  (before the first command)

After its first command, every session ends through DAMP, including after an error, a signal or a
timeout. Time is an argument, in integer nanoseconds of one monotonic clock.
"""

from __future__ import annotations

import logging
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

from g1stream.control.stop import Stop
from g1stream.control.targets import COAST_NS, Ramp, Timing
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from g1stream.control.targets import Setpoint, Targets

__all__ = ["Inputs", "PhaseState", "Schedule", "step"]

_LOGGER = logging.getLogger(__name__)

#: Interval between log messages about what RAMP waits for, ns.
_LOG_INTERVAL: Final = 3_000_000_000
#: Longer than any session, ns.
_FOREVER: Final = 1 << 62


class Inputs(NamedTuple):
    """Inputs of the state machine at a tick.

    Attributes:
        missing: why the first command has to wait, or "".
        stop: why the session must end now, or None.
    """

    missing: str = ""
    stop: Stop | None = None


class PhaseState(NamedTuple):
    """The phase, its start time (ns), and why the session ends early (None if it does not)."""

    phase: Phase
    since: int
    stop: Stop | None = None

    def elapsed(self, now: int) -> int:
        """Time since the phase began, ns."""
        return now - self.since


def step(now: int, state: PhaseState, inputs: Inputs, timing: Timing) -> PhaseState:
    """Advance the state machine to `now`, and return its state.

    A phase with a fixed length ends exactly after this length, and the next one begins there, so
    that late ticks do not shift the phases. Several short phases may pass in one step. DAMP begins
    at `now`, so that it lasts its full time however late the tick is.
    """
    if inputs.stop and state.phase < Phase.DAMP:
        after = Phase.DONE if state.phase is Phase.WAIT else Phase.DAMP
        return PhaseState(after, now, inputs.stop)
    if state.phase is Phase.WAIT:
        return _leave_wait(now, state, inputs, timing)
    while (end := _end_of(state, timing)) is not None and now >= end:
        following = Phase(state.phase + 1)
        state = state._replace(phase=following, since=now if following is Phase.DAMP else end)
    return state


def _leave_wait(now: int, state: PhaseState, inputs: Inputs, timing: Timing) -> PhaseState:
    elapsed = state.elapsed(now)
    if not inputs.missing and elapsed >= timing.settle:
        return PhaseState(Phase.RAMP, now)
    if inputs.missing and elapsed >= timing.wait:
        waited = f"waited for stream.wait = {timing.wait / 1e9:g} s"
        return PhaseState(Phase.DONE, now, Stop("no_robot", f"{inputs.missing} ({waited})"))
    return state


def _end_of(state: PhaseState, timing: Timing) -> int | None:
    length = {
        Phase.RAMP: timing.ramp + timing.awaited,
        Phase.PLAY: timing.play,
        Phase.HOLD: timing.hold + timing.way_down,
        Phase.DAMP: timing.damp,
    }.get(state.phase)
    return None if length is None else state.since + length


class Schedule:
    """The current phase of a session, and its targets. All times are ns of one clock.

    Args:
        targets: the targets of the phases.
        timing: length of each phase; for RAMP, the minimum.
        period: time between commands.
        ramp_speed: maximum joint speed on the way to the first frame, rad/s.
        rests: times in PLAY at which the motion rests until it is told to go on, in order.

    Attributes:
        targets: as given.
        timing: length of each phase, as far as it is known.
        state: the current phase; it can be set.
        delayed: total delay of the phases so far, without rests.
        resting: whether the motion rests.
        ramp: the way to the first frame; None until RAMP begins.
    """

    def __init__(
        self,
        targets: Targets,
        timing: Timing,
        period: int,
        ramp_speed: float = inf,
        rests: Sequence[int] = (),
    ) -> None:
        self.targets, self.timing = targets, timing
        self._period = period
        self._least_ramp, self._ramp_speed = timing.ramp, ramp_speed
        self._rests = [*rests]
        self._logged = -_LOG_INTERVAL  # time in RAMP of the last log message about waiting
        self.state = PhaseState(Phase.WAIT, 0)
        self.delayed = 0
        self.resting = False
        self.ramp: Ramp | None = None

    def advance(self, now: int, inputs: Inputs) -> None:
        """Advance to the phase at `now`."""
        self.state = step(now, self.state, inputs, self.timing)

    def delay(self, gap: int) -> None:
        """Extend the current phase by `gap`."""
        if gap:
            self.state = self.state._replace(since=self.state.since + gap)
            self.delayed += gap

    def begin_ramp(self, q: NDArray[np.floating]) -> None:
        """Begin RAMP at the measured pose `q` (29,), rad."""
        distance = self.targets.begin(q)
        self.ramp = Ramp.for_distance(distance, self._least_ramp, self._ramp_speed)
        self.timing = self.timing._replace(ramp=self.ramp.length, awaited=0)
        self._logged = -_LOG_INTERVAL

    def wait_in_ramp(self, now: int, awaited: str) -> None:
        """Extend RAMP at the first frame while it waits for `awaited`; "" ends the waiting."""
        elapsed = self.state.elapsed(now)
        longer = elapsed + self._period + COAST_NS - self.timing.ramp
        if not awaited or self.state.stop or longer <= self.timing.awaited:
            return
        if elapsed >= self._logged + _LOG_INTERVAL:
            self._logged = elapsed
            _LOGGER.info("RAMP waits: %s", awaited)
        self.timing = self.timing._replace(awaited=longer)

    def rest(self, now: int) -> bool:
        """Stop the motion if it has reached the next rest, and return whether it rests."""
        if self.state.phase is not Phase.PLAY or not self._rests or self.state.stop:
            return False
        over = self.state.elapsed(now) - self._rests[0]
        if self.resting or over >= 0:  # also if the robot's time has moved the phase meanwhile
            # Unlike in `delay`, the time of the motion's clock goes on, by which a policy steps.
            self.state = self.state._replace(since=self.state.since + over)
            self.resting = True
        return self.resting

    def go_on(self) -> None:
        """End the rest."""
        del self._rests[0]
        self.resting = False

    def go_down(self, now: int, stop: Stop, last: Setpoint, *, stands: bool) -> bool:
        """End with the way down, as soon as it is possible; False if there is none.

        Call it at every tick until the end. In RAMP, a robot can go down only if it `stands`. Then
        RAMP stops waiting, and PLAY is skipped.

        Args:
            now: the time.
            stop: why the session ends.
            last: the newest target.
            stands: whether the robot is already on its feet in RAMP.
        """
        state, way_down = self.state, self.targets.way_down
        phases = (Phase.RAMP, Phase.PLAY, Phase.HOLD) if stands else (Phase.PLAY, Phase.HOLD)
        if way_down is None or state.phase not in phases:
            return bool(state.stop)
        if not state.stop and way_down.possible(last):
            play, elapsed = self.timing.play or 0, state.elapsed(now)
            if state.phase is not Phase.HOLD:
                play, elapsed = elapsed if state.phase is Phase.PLAY else 0, 0
            hold = min(self.timing.hold, max(elapsed, COAST_NS))
            self.timing = self.timing._replace(play=play, hold=hold)
            self.state = state._replace(stop=stop)
        return True

    def ramped(self, now: int) -> float:
        """Progress of the ramp as a share of its time, 0 to 1; 1 in other phases."""
        if self.state.phase is not Phase.RAMP:
            return 1.0
        return min(1.0, self.state.elapsed(now) / self.timing.ramp)

    def target(self, now: int, last: Setpoint) -> Setpoint:
        """The target at a time in the current phase; `last` is the previous target."""
        return self.targets.at(self.state.phase, self.state.elapsed(now), self.timing, last)

    def target_ahead(self, then: int, last: Setpoint) -> Setpoint:
        """The target at a later time, in the phase of that time if the session continues."""
        state = step(then, self.state, Inputs(), self.timing._replace(way_down=_FOREVER))
        return self.targets.at(state.phase, state.elapsed(then), self.timing, last)
