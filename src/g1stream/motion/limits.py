"""What a streamed motion asks of the joints, measured against the robot's limits.

The stream samples the spline through a motion's frames. Between two frames the spline is faster
than the frames show, and it may pass a position limit that both frames keep.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.types import STREAM_RATE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from g1stream.motion.motion import Motion
    from g1stream.motion.trajectory import Trajectory
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = [
    "POSITION_TOLERANCE",
    "Interval",
    "JointSpeed",
    "LimitReport",
    "PositionExcess",
    "frames_beyond_limits",
    "measure_limits",
]

POSITION_TOLERANCE: Final = 1e-6
"""An angle this far beyond a position limit still counts as at the limit, rad.

The only threshold, for frames, for the spline and for the targets that the safety envelope counts
as held. Motion files have six decimals, so that a joint at a limit such as 1.614429558 rad is
written up to 5e-7 rad beyond it, and the spline through such frames differs by a rounding error
more. Anything larger is reported: a wider tolerance would leave out joint targets that the stream
holds and counts, and report and summary would disagree. How far a target is beyond its limit stands
in the report, so that a reader can tell an overshoot of 0.01 rad from a fault of the motion.
"""

#: Targets sampled at once, so that a long motion takes no more memory than a short one.
_BLOCK: Final = 4096
#: Joints that a warning names beside the worst one.
_NAMED: Final = 3


@dataclass(frozen=True)
class Interval:
    """The part of a motion to be played.

    Attributes:
        start: where in the motion it begins, s.
        length: how long it is, s; None: without end.
        motion: duration of the whole motion, s.
        loop: whether the motion repeats.
    """

    start: float
    length: float | None
    motion: float
    loop: bool = False


@dataclass(frozen=True)
class JointSpeed:
    """The highest speed of a joint.

    Attributes:
        joint: its name.
        time: s from frame 0.
        value: rad/s, in either direction.
        limit: rad/s, the joint's velocity limit.
    """

    joint: str
    time: float
    value: float
    limit: float


@dataclass(frozen=True)
class PositionExcess:
    """A joint beyond a position limit, at frames or at streamed targets.

    Attributes:
        joint: its name.
        count: at how many frames or targets it is beyond a limit.
        time: s from frame 0, where it is furthest beyond.
        value: rad, its position there.
        limit: rad, the limit that it passes there, narrowed by the position margin if any.
    """

    joint: str
    count: int
    time: float
    value: float
    limit: float


@dataclass(frozen=True)
class LimitReport:
    """What a streamed motion asks of the joints.

    Attributes:
        motion: its name.
        duration: s, from frame 0 to the last frame.
        rate: joint targets per second, Hz.
        position_margin: rad, by which position limits are narrowed.
        speeds: the highest speed of each joint, largest share of its limit first.
        held: the joints with targets beyond a position limit, furthest first; the stream holds them
            at the limit.
    """

    motion: str
    duration: float
    rate: float
    position_margin: float
    speeds: tuple[JointSpeed, ...]
    held: tuple[PositionExcess, ...]

    @property
    def too_fast(self) -> tuple[JointSpeed, ...]:
        """Joints asked to move faster than their limit, the worst first."""
        return tuple(speed for speed in self.speeds if speed.value > speed.limit)

    @property
    def n_held(self) -> int:
        """How many joint targets are held at a limit."""
        return sum(joint.count for joint in self.held)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A warning for positions and one for speeds, where a limit is passed."""
        warnings = []
        if self.held:
            worst = self.held[0]
            margin = f" less a margin of {self.position_margin:g}" if self.position_margin else ""
            warnings.append(
                f"{self.motion} asks {worst.joint} for {worst.value:.3f} rad "
                f"{self._when(worst.time)}, limit {worst.limit:.3f}{margin}{_others(self.held)}. "
                f"{self.n_held} joint targets at {self.rate:g} Hz are held at the limit."
            )
        if self.too_fast:
            fastest = self.too_fast[0]
            warnings.append(
                f"{self.motion} asks {fastest.joint} for {fastest.value:.1f} rad/s "
                f"{self._when(fastest.time)}, limit {fastest.limit:g}{_others(self.too_fast)}. "
                "Joints that cannot follow lag behind."
            )
        return tuple(warnings)

    def _when(self, time: float) -> str:
        if time > self.duration:  # only a loop has samples there
            return "on the way back to its first frame"
        return f"at {time:.2f} s"


def measure_limits(
    trajectory: Trajectory,
    robot: G1,
    interval: Interval | None = None,
    *,
    rate: float = STREAM_RATE,
    position_margin: float = 0.0,
) -> LimitReport:
    """Measure every joint target that is streamed.

    Args:
        trajectory: of a motion with the robot's joints.
        robot: has the limits.
        interval: the part to be played, of a loop at most one round; the whole motion if None.
        rate: joint targets per second, Hz; they are taken at the times start + i / rate.
        position_margin: rad, kept from the position limits, as `safety.position_margin`.
    """
    motion, n_joints = trajectory.motion, len(robot.joint_names)
    interval = interval or Interval(0.0, motion.duration, motion.duration)
    excess, speed = _Excess(robot, position_margin), _Peaks(n_joints)
    for target_times in _target_times(trajectory, interval, rate):
        point = trajectory.sample_many(target_times)
        times = target_times % trajectory.period if trajectory.loop else target_times
        excess.update(times, point.joint_pos)
        speed.update(times, np.abs(point.joint_vel))
    return LimitReport(
        motion=motion.name,
        duration=motion.duration,
        rate=rate,
        position_margin=position_margin,
        speeds=tuple(
            JointSpeed(robot.joint_names[j], *speed.at(j), float(robot.velocity[j]))
            for j in np.argsort(-speed.value / robot.velocity, kind="stable")
        ),
        held=excess.found(),
    )


def frames_beyond_limits(motion: Motion, robot: G1) -> tuple[PositionExcess, ...]:
    """The joints that are beyond a position limit in the frames of a motion, furthest first."""
    excess = _Excess(robot, 0.0)
    excess.update(np.arange(motion.n_frames) / motion.fps, motion.joint_pos)
    return excess.found()


class _Peaks:
    """The highest value above 0 of each joint so far, and its time."""

    def __init__(self, n_joints: int) -> None:
        self.value, self.time = np.zeros((2, n_joints))

    def update(self, times: Floats, values: Floats) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Add values (N, J); return the row of each highest, and whether it is a new peak."""
        row, highest = values.argmax(axis=0), values.max(axis=0)
        higher = highest > self.value
        self.value[higher], self.time[higher] = highest[higher], times[row[higher]]
        return row, higher

    def at(self, joint: int) -> tuple[float, float]:
        """Time and value."""
        return float(self.time[joint]), float(self.value[joint])


class _Excess:
    """How far each joint has been beyond its position limits, and how often."""

    def __init__(self, robot: G1, margin: float) -> None:
        self._names = robot.joint_names
        self._lower, self._upper = robot.lower + margin, robot.upper - margin
        self._peaks, self._position = _Peaks(len(self._names)), np.zeros(len(self._names))
        self._count = np.zeros(len(self._names), dtype=np.int64)

    def update(self, times: Floats, joint_pos: Floats) -> None:
        beyond = np.maximum(self._lower - joint_pos, joint_pos - self._upper)
        self._count += (beyond > POSITION_TOLERANCE).sum(axis=0)
        row, higher = self._peaks.update(times, beyond)
        self._position[higher] = joint_pos[row[higher], np.flatnonzero(higher)]

    def found(self) -> tuple[PositionExcess, ...]:
        limit = np.where(self._position < self._lower, self._lower, self._upper)
        return tuple(
            PositionExcess(
                self._names[j],
                int(self._count[j]),
                float(self._peaks.time[j]),
                float(self._position[j]),
                float(limit[j]),
            )
            for j in np.argsort(-self._peaks.value, kind="stable")
            if self._count[j]
        )


def _target_times(trajectory: Trajectory, interval: Interval, rate: float) -> Iterator[Floats]:
    """Times of the joint targets in the interval, s, a block at a time; of a loop, one round."""
    once = trajectory.period if interval.loop else trajectory.duration - interval.start
    length = once if interval.length is None else min(interval.length, once)
    n_targets = floor(length * rate + 1e-6) + 1  # rounding must not lose the last one
    for first in range(0, n_targets, _BLOCK):
        numbers = np.arange(first, min(first + _BLOCK, n_targets))
        # Nor put it behind the end, where the trajectory rests.
        yield interval.start + np.minimum(numbers / rate, length)


def _others(joints: Sequence[JointSpeed | PositionExcess]) -> str:
    names = [joint.joint for joint in joints[1:]]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"; also {', '.join(names[:_NAMED])}{more}" if names else ""
