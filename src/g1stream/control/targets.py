"""From the phase and the motion to what each joint is asked for; pure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from g1stream.control.phases import Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.motion.trajectory import Trajectory, TrajectoryPoint

__all__ = ["Target", "Targets", "minimum_jerk"]


@dataclass(frozen=True)
class Target:
    """What the motion asks for at one instant.

    Attributes:
        motion_time: s since the motion's first frame.
        q, dq, ddq, tau: (29,) rad, rad/s, rad/s^2, Nm, motor order.
        root_pos: (3,) m, world.
        root_quat_wxyz: (4,) pelvis to world.
        root_lin_vel: (3,) m/s, world.
        root_ang_vel: (3,) rad/s, pelvis frame.
    """

    motion_time: float
    q: NDArray[np.float64]
    dq: NDArray[np.float64]
    ddq: NDArray[np.float64]
    tau: NDArray[np.float64]
    root_pos: NDArray[np.float64]
    root_quat_wxyz: NDArray[np.float64]
    root_lin_vel: NDArray[np.float64]
    root_ang_vel: NDArray[np.float64]

    def at_rest(self) -> Target:
        """The same pose, with no velocity, acceleration or torque."""
        still, nowhere = np.zeros_like(self.q), np.zeros(3)
        return replace(
            self, dq=still, ddq=still, tau=still, root_lin_vel=nowhere, root_ang_vel=nowhere
        )


def minimum_jerk(s: float) -> tuple[float, float, float]:
    """Progress, its rate and its acceleration at the fraction `s` of a minimum-jerk move.

    The fifth-order polynomial 10 s^3 - 15 s^4 + 6 s^5 that starts and ends at rest with no
    acceleration: T. Flash and N. Hogan, "The coordination of arm movements", 1985.
    """
    s = min(1.0, max(0.0, s))
    progress = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
    rate = 30.0 * s**2 * (1.0 - s) ** 2
    acceleration = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    return progress, rate, acceleration


class Targets:
    """Samples the motion as each phase asks for it.

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
        self._last = self._at_rest(start)

    def begin(self, q: NDArray[np.floating]) -> None:
        """Set the measured pose (29,) that the ramp starts from, rad."""
        self._from = np.asarray(q, dtype=np.float64).copy()

    def at(self, phase: Phase, elapsed: float) -> Target:
        """The target in a phase.

        Args:
            phase: RAMP, PLAY, HOLD or DAMP.
            elapsed: s since the phase began.
        """
        if phase is Phase.RAMP:
            self._last = self._ramping(elapsed)
        elif phase is Phase.PLAY:
            self._last = self._playing(elapsed)
        elif phase is Phase.HOLD:
            self._last = self._at_rest(self._start + (self._play or 0.0))
        else:
            self._last = self._last.at_rest()
        return self._last

    def _playing(self, elapsed: float) -> Target:
        within = elapsed if self._play is None else min(elapsed, self._play)
        time = self._start + within
        return _moving(time, self._trajectory.sample(time))

    def _at_rest(self, time: float) -> Target:
        return _moving(time, self._trajectory.sample(time)).at_rest()

    def _ramping(self, elapsed: float) -> Target:
        goal = self._at_rest(self._start)
        if self._from is None:
            raise RuntimeError("the ramp has no pose to start from: call begin() first")
        progress, rate, acceleration = minimum_jerk(elapsed / self._ramp)
        way = goal.q - self._from
        return replace(
            goal,
            q=self._from + progress * way,
            dq=rate / self._ramp * way,
            ddq=acceleration / self._ramp**2 * way,
        )


def _moving(time: float, point: TrajectoryPoint) -> Target:
    return Target(
        time,
        point.joint_pos,
        point.joint_vel,
        point.joint_acc,
        np.zeros_like(point.joint_pos),
        point.root_pos,
        point.root_quat_wxyz,
        point.root_lin_vel,
        point.root_ang_vel,
    )
