"""Whether a robot can go from each recorded command to the next, and in time; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.replay.recorded_link import LEAP_TIME
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray


__all__ = ["JITTER", "ROUNDING", "Steps", "disorder", "pause"]

#: Commands are float32: a target at a limit may be beyond it by its rounding, rad.
ROUNDING: Final = 1e-6

JITTER: Final = 0.002
"""By how much the stamps of two commands may be too close, because the first came late, s.

It is the period of 500 Hz: who publishes at that rate and is later than that skips a tick.
"""


class Steps:
    """How far joint targets move from one command to the next, by what the joints can do.

    Args:
        velocity: (29,) what the joints can do, rad/s.
        jitter: by how much times may be too close, s; 0 where they are of no clock.
    """

    def __init__(self, velocity: Floats, jitter: float) -> None:
        self._velocity, self._jitter = velocity, jitter
        self._last: NDArray[np.float32] = np.empty((0, N_JOINTS), np.float32)
        #: Of each step, in which time the joint that has furthest to go can make it, s; and which.
        self._needed: list[Floats] = [np.empty(0)]
        self._joints: list[NDArray[np.intp]] = [np.empty(0, np.intp)]

    def add(self, q: NDArray[np.float32]) -> None:
        """Go on with the targets (n, 29) of the next commands, rad."""
        needed = np.abs(np.diff(np.concatenate([self._last, q]), axis=0)) / self._velocity
        if len(q):
            self._last = q[-1:]
        if len(needed):
            self._needed.append(needed.max(axis=1))
            self._joints.append(needed.argmax(axis=1))

    def leap(self, times: Floats, speed: float) -> str:
        """Which of the commands due at these times (N,), s, is a leap, or "".

        None is that a joint can make in the time between two commands and the jitter, of which no
        more than `LEAP_TIME` counts. Nor may what jitter excuses add up to more than that.
        """
        between = np.diff(times) / speed
        allowed = np.minimum(between + self._jitter / speed, LEAP_TIME)
        needed = np.concatenate(self._needed)
        slack = ROUNDING / self._velocity.min()
        beyond = np.flatnonzero(needed > 1.001 * allowed + slack)
        if len(beyond):
            joint, velocity, at = self._step(int(beyond[0]), times)
            far, may = velocity * needed[beyond[0]], velocity * allowed[beyond[0]]
            return (
                f"asks {joint}, {at}, to leap by {far:.3f} rad from the command before it, where "
                f"its {velocity:g} rad/s allow {may:.3f}"
            )
        ahead = _ahead(needed - 1.001 * between - slack)
        beyond = np.flatnonzero(ahead > LEAP_TIME)
        if len(beyond):
            joint, velocity, at = self._step(int(beyond[0]), times)
            return (
                f"comes too soon after those before it, {at}: {joint} with its {velocity:g} rad/s "
                f"would be {ahead[beyond[0]]:.3f} s behind (limit {LEAP_TIME:g} s)"
            )
        return ""

    def _step(self, i: int, times: Floats) -> tuple[str, float, str]:
        """Of a step: the joint that has furthest to go, its rad/s, and when that is."""
        joint = int(np.concatenate(self._joints)[i])
        when = f"{times[i + 1]:.3f} s into the motion"
        return JOINT_NAMES[joint], float(self._velocity[joint]), when


def _ahead(lacking: Floats) -> Floats:
    """By how much targets are ahead of what joints can do after each step (n,), s.

    Time that a step lacks adds up; what it has to spare makes up for steps before it, and for none
    after it.
    """
    total = np.cumsum(lacking)
    return total - np.minimum(np.minimum.accumulate(total), 0.0)


def disorder(times: Floats) -> str:
    """Which command is due (N,), s, before the one that precedes it, or ""."""
    back = np.flatnonzero(np.diff(times) < 0.0)
    if not len(back):
        return ""
    i = int(back[0])
    return (
        f"comes {times[i]:.3f} s into the motion and is followed by one of {times[i + 1]:.3f} s: "
        "more than one motion was played, or the clock was set back"
    )


def pause(times: Floats, longest: float, speed: float) -> str:
    """Where a command would be sent for too long, because the next is missing; or ""."""
    between = np.diff(times) / speed
    if between.max() <= longest + 1e-9:
        return ""
    i = int(np.argmax(between))
    return (
        f"would stand for others that are missing, from {times[i]:.3f} to {times[i + 1]:.3f} s of "
        f"the motion: played, {between[i]:.3f} s (limit {longest:g} s, safety.state_timeout)"
    )
