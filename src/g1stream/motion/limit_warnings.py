"""What a motion asks for beyond the robot's limits, told before it is played."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.motion.trajectory import Trajectory
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator

    from g1stream.config import Config
    from g1stream.motion.motion import Motion
    from g1stream.motion.trajectory import TrajectoryPoint
    from g1stream.robot.model import G1


__all__ = ["Interval", "beyond_limits"]


@dataclass(frozen=True)
class Interval:
    """The part of a motion that was to be played.

    Attributes:
        start: where in the motion it begins, s.
        length: how long it is, s; None: without end.
        motion: how long the whole motion is, s.
        loop: whether the motion is played again and again.
    """

    start: float
    length: float | None
    motion: float
    loop: bool = False


#: By so much a spline overshoots its frames between them, which is not worth a warning, rad.
_SLIGHT: Final = 0.02
#: Targets that are computed at once, so that a long motion takes no more memory than a short one.
_AT_ONCE: Final = 10_000


class _Peaks(NamedTuple):
    """Of each joint the target furthest from its limit: how far, when, and what is asked there."""

    beyond: Floats
    time: Floats
    asked: Floats

    @classmethod
    def none(cls, n_joints: int) -> _Peaks:
        return cls(np.full(n_joints, -np.inf), np.zeros(n_joints), np.zeros(n_joints))

    def with_targets(self, beyond: Floats, times: Floats, asked: Floats) -> _Peaks:
        row, joint = beyond.argmax(axis=0), np.arange(beyond.shape[1])
        further = beyond[row, joint] > self.beyond
        return _Peaks(
            np.where(further, beyond[row, joint], self.beyond),
            np.where(further, times[row], self.time),
            np.where(further, asked[row, joint], self.asked),
        )


def beyond_limits(motion: Motion, robot: G1, config: Config, interval: Interval) -> list[str]:
    """Warnings, a sentence each, of joints that are asked further or faster than they can.

    Args:
        motion: with the robot's joints.
        robot: whose limits.
        config: the rate of commands, and what is kept from the limits.
        interval: the part of the motion that is played; where it loops, with the way back.

    Raises:
        MotionError: the motion's joints are not the robot's, in the robot's order.
    """
    motion.require_joints_of(robot)
    margin = config.safety.position_margin
    lower, upper = robot.lower + margin, robot.upper - margin
    trajectory = Trajectory(motion, loop=interval.loop)
    far = fast = _Peaks.none(len(robot.joint_names))
    for times, asked in _targets(trajectory, interval, config.stream.rate):
        q, speed = asked.joint_pos, np.abs(asked.joint_vel)
        far = far.with_targets(np.maximum(lower - q, q - upper), times, q)
        fast = fast.with_targets(speed / robot.velocity - 1.0, times, speed)
    warnings = []
    if n := int((far.beyond > _SLIGHT).sum()):
        j = int(far.beyond.argmax())
        limit = lower[j] if far.asked[j] < lower[j] else upper[j]
        warnings.append(
            f"{motion.name} asks {robot.joint_names[j]} for {far.asked[j]:.2f} rad "
            f"{_when(far.time[j], trajectory)}, and its limit is {limit:.2f}"
            f"{_others(n - 1)}. Commands are held at the limits."
        )
    if n := int((fast.beyond > 0.0).sum()):
        j = int(fast.beyond.argmax())
        warnings.append(
            f"{motion.name} asks {robot.joint_names[j]} for {fast.asked[j]:.1f} rad/s "
            f"{_when(fast.time[j], trajectory)}, and its limit is {robot.velocity[j]:g}"
            f"{_others(n - 1)}. Joints follow as fast as their motors can."
        )
    return warnings


def _targets(
    trajectory: Trajectory, interval: Interval, rate: float
) -> Iterator[tuple[Floats, TrajectoryPoint]]:
    """What is asked for at every command of the interval, and when, s; of a loop, one round."""
    once = trajectory.period if interval.loop else trajectory.duration - interval.start
    length = once if interval.length is None else min(interval.length, once)
    n_commands = math.floor(length * rate) + 1
    for first in range(0, n_commands, _AT_ONCE):
        numbers = np.arange(first, min(first + _AT_ONCE, n_commands))
        times = interval.start + numbers / rate
        yield times, trajectory.sample_many(times)


def _when(time: float, trajectory: Trajectory) -> str:
    """Where in the motion that is, or that it is on the way back to where it begins."""
    if trajectory.loop:
        time %= trajectory.period
        if time > trajectory.duration:
            return "on the way back to its first frame"
    return f"at {time:.2f} s"


def _others(n: int) -> str:
    return f"; {n} other joint{'s' * (n != 1)} beyond theirs" if n else ""
