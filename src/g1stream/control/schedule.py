"""Where a session is, and the target of any of its times; pure."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from g1stream.control.phases import Inputs, PhaseState, Timing, step
from g1stream.motion.blend import COAST, minimum_jerk
from g1stream.types import Phase

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from g1stream.control.targets import Ramp, Target, Targets

__all__ = ["Schedule"]

_LOGGER = logging.getLogger(__name__)

#: What RAMP waits for is said again after this, ns.
_TOLD_AGAIN: Final = 3_000_000_000
#: Longer than any session, ns.
_FOREVER: Final = 1 << 62


class Schedule:
    """The phase of a session, its lengths, and its targets. All times are ns of one clock.

    Args:
        targets: the target of each phase.
        timing: length of each phase.
        period: between commands.

    Attributes:
        state: the current phase. It may be set.
    """

    def __init__(self, targets: Targets, timing: Timing, period: int) -> None:
        self._targets = targets
        self._timing = timing
        self._period = period
        self._told = -_TOLD_AGAIN  # when in RAMP it was said that it waits
        self.state = PhaseState(Phase.WAIT, 0)

    @property
    def first(self) -> Target:
        """The first target of PLAY."""
        return self._targets.first

    @property
    def damp(self) -> int:
        """Length of DAMP."""
        return self._timing.damp

    def advance(self, now: int, inputs: Inputs) -> None:
        """Go on to the phase at `now`."""
        self.state = step(now, self.state, inputs, self._timing)

    def delay(self, gap: int) -> None:
        """The phase ends later by `gap`."""
        self.state = replace(self.state, since=self.state.since + gap)

    def begin_ramp(self, q: NDArray[np.floating]) -> Ramp:
        """RAMP begins at the measured pose `q` (29,), rad."""
        ramp = self._targets.begin(q)
        self._timing = replace(self._timing, ramp=round(ramp.length * 1e9))
        self._told = -_TOLD_AGAIN
        return ramp

    def wait_in_ramp(self, now: int, awaited: str) -> None:
        """Let RAMP end, at rest, no earlier than what is `awaited` has come; "" if nothing is."""
        elapsed = self.state.elapsed(now)
        end = elapsed + self._period + round(COAST * 1e9)
        if not awaited or self.state.reason or end <= self._timing.ramp:
            return
        if elapsed >= self._told + _TOLD_AGAIN:
            self._told = elapsed
            _LOGGER.info("RAMP waits: %s", awaited)
        self._timing = replace(self._timing, ramp=end)
        self._targets.ramp_end = end / 1e9

    def squat_down(self, now: int, reason: str, *, stands: bool) -> bool:
        """End with a squat, now or as soon as both feet stand; False if the robot cannot squat.

        To be called at every tick until the end. From RAMP a robot can if it `stands`: RAMP waits
        no longer, and PLAY has no length.
        """
        state = self.state
        phases = (Phase.RAMP, Phase.PLAY, Phase.HOLD) if stands else (Phase.PLAY, Phase.HOLD)
        if not self._targets.squats or state.phase not in phases:
            return bool(state.reason)
        if not state.reason and self._targets.may_end():
            play, elapsed = self._timing.play or 0, state.elapsed(now)
            if state.phase is not Phase.HOLD:
                play, elapsed = elapsed if state.phase is Phase.PLAY else 0, 0
            hold = min(self._timing.hold, max(elapsed, round(COAST * 1e9)))
            self._targets.end(play / 1e9, hold / 1e9)
            self._timing = replace(self._timing, play=play, hold=hold)
            self.state = replace(state, reason=reason)
        return True

    def ramped(self, now: int) -> float:
        """Progress of the ramp to the motion's first frame, 0 to 1."""
        if self.state.phase is not Phase.RAMP:
            return 1.0
        return minimum_jerk(self.state.elapsed(now) / self._timing.ramp)[0]

    def target(self, now: int) -> Target:
        """The target at a time in the current phase."""
        return self._targets.at(self.state.phase, self.state.elapsed(now) / 1e9)

    def target_ahead(self, then: int) -> Target:
        """The target at a later time, in the phase of that time, if the session continues."""
        state = step(then, self.state, Inputs(), replace(self._timing, hold=_FOREVER))
        return self._targets.at(state.phase, state.elapsed(then) / 1e9)
