"""From the phase and the motion to what each joint is asked for; pure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.phases import Phase
from g1stream.robot.rotations import quat_from_axis_angle, quat_mul

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.motion.trajectory import Trajectory, TrajectoryPoint

__all__ = ["UNPUBLISHED", "Target", "Targets", "coast", "minimum_jerk"]

#: What a target knows that a Reference does not say.
UNPUBLISHED: Final = frozenset({"root_lin_acc", "root_ang_acc"})

#: Seconds in which the motion's first velocity is run up to, and its last one dies away.
_COAST: Final = 0.2


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
        root_lin_acc: (3,) m/s^2, world, without gravity.
        root_ang_acc: (3,) rad/s^2, pelvis frame, the time derivative of `root_ang_vel`.
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
    root_lin_acc: NDArray[np.float64]
    root_ang_acc: NDArray[np.float64]

    def at_rest(self) -> Target:
        """The same pose, with no velocity, acceleration or torque."""
        still, nowhere = np.zeros_like(self.q), np.zeros(3)
        return replace(
            self,
            dq=still,
            ddq=still,
            tau=still,
            root_lin_vel=nowhere,
            root_ang_vel=nowhere,
            root_lin_acc=nowhere,
            root_ang_acc=nowhere,
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


def coast(seconds: float, length: float) -> tuple[float, float, float]:
    """How far something of unit velocity has come, its velocity and its acceleration, braking.

    The fifth-order polynomial that starts with velocity 1 and without acceleration, and ends with
    neither, where it started: x - 6 x^3 + 8 x^4 - 3 x^5 of x = t / T, times T.

    Args:
        seconds: since it began to brake.
        length: how long it takes, s; after that it rests.
    """
    x = min(1.0, seconds / length)
    way = length * x * (1.0 - x) ** 3 * (1.0 + 3.0 * x)
    rate = 1.0 + x * x * (-18.0 + x * (32.0 - 15.0 * x))
    acceleration = x * (-36.0 + x * (96.0 - 60.0 * x)) / length
    return way, rate, acceleration


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
        self._first = _moving(start, trajectory.sample(start))
        self._last = self._first.at_rest()

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
            self._last = _coasting(self._playing(self._play or 0.0), *coast(elapsed, _COAST))
        else:
            self._last = self._last.at_rest()
        return self._last

    def _playing(self, elapsed: float) -> Target:
        within = elapsed if self._play is None else min(elapsed, self._play)
        time = self._start + within
        return _moving(time, self._trajectory.sample(time))

    def _ramping(self, elapsed: float) -> Target:
        if self._from is None:
            raise RuntimeError("the ramp has no pose to start from: call begin() first")
        left = max(0.0, self._ramp - elapsed)
        way, rate, acceleration = coast(left, min(_COAST, self._ramp))  # braking, run backwards
        goal = _coasting(self._first, -way, rate, -acceleration)
        progress, speed, change = minimum_jerk(elapsed / self._ramp)
        distance = self._first.q - self._from
        return replace(
            goal,
            q=self._from + progress * distance - way * self._first.dq,
            dq=goal.dq + speed / self._ramp * distance,
            ddq=goal.ddq + change / self._ramp**2 * distance,
        )


def _coasting(target: Target, way: float, rate: float, acceleration: float) -> Target:
    """A target moved on along its own velocity, as if that had lasted `way` seconds."""
    turn = target.root_ang_vel
    angle = float(np.linalg.norm(turn))
    axis = turn / angle if angle else turn
    return replace(
        target,
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
        point.root_lin_acc,
        point.root_ang_acc,
    )
