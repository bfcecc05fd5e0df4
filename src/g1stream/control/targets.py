"""From the phase and the motion to what each joint is asked for; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.control.target import Target
from g1stream.motion.blend import COAST, coast, minimum_jerk
from g1stream.robot.rotations import quat_from_axis_angle, quat_mul
from g1stream.types import Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.motion.trajectory import Trajectory

__all__ = ["Targets"]


class Targets:
    """Samples the motion as each phase asks for it.

    The velocity of what is asked for never jumps, so that no servo has to catch up: the ramp runs
    up to the velocity of the motion's first frame, and HOLD lets the last one's die away.

    Args:
        trajectory: the motion, sampled at any time.
        start: where in the motion PLAY begins, s.
        play: how much of it is played, s; None for a motion that loops.
        ramp: how long the way to the first frame takes, s.
    """

    def __init__(
        self, trajectory: Trajectory, *, start: float, play: float | None, ramp: float
    ) -> None:
        self._trajectory = trajectory
        self._start = start
        self._play = play
        self._ramp = ramp
        self._from: NDArray[np.float64] | None = None
        self._first = Target.of(start, trajectory.sample(start))
        self._last = self._first.at_rest()
        self._sampled = self._first

    def begin(self, q: NDArray[np.floating]) -> None:
        """Set the measured pose (29,) that the ramp starts from, rad."""
        self._from = np.asarray(q, dtype=np.float64).copy()

    def at(self, phase: Phase, elapsed: float) -> Target:
        """The target in a phase.

        Args:
            phase: RAMP, PLAY, HOLD or DAMP.
            elapsed: s since the phase began.
        """
        if phase is Phase.PLAY:
            self._last = self._playing(elapsed)
        elif phase is Phase.RAMP:
            self._last = self._ramping(elapsed)
        elif phase is Phase.HOLD:
            self._last = _coasting(self._playing(self._play or 0.0), *coast(elapsed, COAST))
        else:
            self._last = self._last.at_rest()
        return self._last

    def _playing(self, elapsed: float) -> Target:
        time = self._start + (elapsed if self._play is None else min(elapsed, self._play))
        # A loop that looks a tick ahead asks again for what it saw there.
        if time != self._sampled.motion_time:
            self._sampled = Target.of(time, self._trajectory.sample(time))
        return self._sampled

    def _ramping(self, elapsed: float) -> Target:
        if self._from is None:
            raise RuntimeError("the ramp has no pose to start from: call begin() first")
        left = max(0.0, self._ramp - elapsed)
        way, rate, acceleration = coast(left, min(COAST, self._ramp))  # braking, run backwards
        goal = _coasting(self._first, -way, rate, -acceleration)
        progress, speed, change = minimum_jerk(elapsed / self._ramp)
        distance = self._first.q - self._from
        return goal.but(
            q=self._from + progress * distance - way * self._first.dq,
            dq=goal.dq + speed / self._ramp * distance,
            ddq=goal.ddq + change / self._ramp**2 * distance,
        )


def _coasting(target: Target, way: float, rate: float, acceleration: float) -> Target:
    """A target moved on along its own velocity, as if that had lasted `way` seconds."""
    turn = target.root_ang_vel
    angle = float(np.linalg.norm(turn))
    axis = turn / angle if angle else turn
    return target.but(
        q=target.q + way * target.dq,
        dq=rate * target.dq,
        ddq=acceleration * target.dq,
        root_pos=target.root_pos + way * target.root_lin_vel,
        root_quat_wxyz=quat_mul(
            target.root_quat_wxyz, quat_from_axis_angle(axis, np.asarray(way * angle))
        ),
        root_lin_vel=rate * target.root_lin_vel,
        root_ang_vel=rate * turn,
        root_lin_acc=acceleration * target.root_lin_vel,
        root_ang_acc=acceleration * turn,
    )
