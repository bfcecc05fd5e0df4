"""What a streamed motion asks of the joints, measured against the robot's limits.

The stream samples the spline through a motion's frames. Between two frames the spline is faster
than the frames show, and it may pass a position limit that both frames keep.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from math import ceil, floor
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.text import counted, listed
from g1stream.types import STREAM_RATE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from g1stream.config import StreamConfig
    from g1stream.motion.motion import Motion
    from g1stream.motion.trajectory import Trajectory
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = [
    "POSITION_TOLERANCE",
    "Interval",
    "JointPeak",
    "LimitReport",
    "frame_peaks",
    "measure_limits",
]

POSITION_TOLERANCE: Final = 1e-6
"""An angle this far beyond a position limit still counts as at the limit, rad.

The only threshold, for frames, for the spline and for the targets that are counted as held:
with a wider one, report and summary would disagree. Motion files have six decimals, so that a
joint at a limit such as 1.614429558 rad is written up to 5e-7 rad beyond it.
"""

#: Holding a joint at its limit changes the motion by less than a robot follows it, up to this, rad.
_SLIGHT: Final = 0.02
#: Targets sampled at once: those of a long motion take many times the memory of its spline.
_BLOCK: Final = 4096


@dataclass(frozen=True)
class Interval:
    """The part of a motion to be played."""

    start: float  # where in the motion it begins, s
    length: float | None  # s; None: without end
    loop: bool = False  # the motion repeats

    @classmethod
    def from_config(cls, settings: StreamConfig, motion: Motion) -> Interval:
        """The part of a motion that is played with these settings.

        Raises:
            ConfigError: it would begin after the end of the motion.
        """
        start, length = settings.start, settings.duration
        if start >= motion.duration:
            raise ConfigError(
                f"stream.start = {start:g} s is not within {motion.name}, which is "
                f"{motion.duration:.2f} s long.",
                "Give an earlier --start.",
            )
        if not settings.loop:
            rest = motion.duration - start
            length = rest if length is None else min(length, rest)
        return cls(start, length, settings.loop)

    def frames(self, motion: Motion) -> range:
        """The frames of a motion between which it is interpolated; all of one that repeats."""
        if self.loop or self.length is None:
            return range(motion.n_frames)
        first, last = (time * motion.fps for time in (self.start, self.start + self.length))
        return range(floor(first + 1e-6), min(ceil(last - 1e-6) + 1, motion.n_frames))


@dataclass(frozen=True)
class JointPeak:
    """Where a joint's position or speed is furthest beyond a limit, or closest to it."""

    joint: str
    time: float  # s from frame 0
    value: float  # position, rad, or speed in either direction, rad/s
    limit: float  # the one that it is beyond or closest to
    count: int  # frames or streamed targets beyond a limit


@dataclass(frozen=True)
class LimitReport:
    """What a streamed motion asks of the joints."""

    motion: str
    duration: float  # s, from frame 0 to the last frame
    rate: float  # joint targets per second, Hz
    position_margin: float  # rad, by which position limits are narrowed
    speeds: tuple[JointPeak, ...]  # the highest of each joint, largest share of its limit first
    held: tuple[JointPeak, ...]  # joints with targets held at a position limit, furthest first

    @property
    def too_fast(self) -> tuple[JointPeak, ...]:
        return tuple(speed for speed in self.speeds if speed.count)

    @property
    def n_held(self) -> int:
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
                f"{counted(self.n_held, 'joint target')} at {self.rate:g} Hz held at the limit."
            )
        if self.too_fast:
            fastest = self.too_fast[0]
            warnings.append(
                f"{self.motion} asks {fastest.joint} for {fastest.value:.1f} rad/s "
                f"{self._when(fastest.time)}, limit {fastest.limit:g}{_others(self.too_fast)}. "
                "Joints that cannot follow lag behind."
            )
        return tuple(warnings)

    @property
    def events(self) -> tuple[tuple[int, str], ...]:
        """The warnings with the level at which to log them: INFO for targets slightly beyond."""
        slight = self.held and abs(self.held[0].value - self.held[0].limit) <= _SLIGHT
        return tuple(
            (logging.INFO if slight and not number else logging.WARNING, text)
            for number, text in enumerate(self.warnings)
        )

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
    motion = trajectory.motion
    interval = interval or Interval(0.0, motion.duration)
    lower, upper = robot.lower + position_margin, robot.upper - position_margin

    positions = _Peaks(robot, lower, upper)
    speeds = _Peaks(robot, -robot.velocity, robot.velocity)
    for times in _target_times(trajectory, interval, rate):
        joint_pos, joint_vel = trajectory.sample_joints(times)
        since = times % trajectory.period if trajectory.loop else times
        positions.update(since, joint_pos)
        speeds.update(since, np.abs(joint_vel))
    return LimitReport(
        motion=motion.name,
        duration=motion.duration,
        rate=rate,
        position_margin=position_margin,
        speeds=tuple(sorted(speeds.all(), key=lambda speed: -speed.value / speed.limit)),
        held=positions.beyond(),
    )


def frame_peaks(
    motion: Motion, robot: G1, interval: Interval | None = None
) -> tuple[tuple[JointPeak, ...], JointPeak]:
    """The joints beyond a position limit in the frames of an interval, and the fastest joint.

    Speeds at the frames, of the whole motion, are central differences, as most tools compute them.
    """
    times = np.arange(motion.n_frames) / motion.fps
    positions = _Peaks(robot, robot.lower, robot.upper)
    frames = interval.frames(motion) if interval else range(motion.n_frames)
    played = slice(frames.start, frames.stop)
    positions.update(times[played], motion.joint_pos[played])
    speeds = _Peaks(robot, -robot.velocity, robot.velocity)
    steps = np.gradient(motion.joint_pos, axis=0)
    np.abs(steps, out=steps)
    steps *= motion.fps
    speeds.update(times, steps)
    return positions.beyond(), max(speeds.all(), key=lambda speed: speed.value)


class _Peaks:
    """Accumulates the peak of each joint, from values (N, J) at times (N,)."""

    def __init__(self, robot: G1, lower: Floats, upper: Floats) -> None:
        self._names, self._lower, self._upper = robot.joint_names, lower, upper
        self._excess = np.full(len(lower), -np.inf)
        self._time, self._value = np.zeros((2, len(lower)))
        self._count = np.zeros(len(lower), dtype=np.int64)

    def update(self, times: Floats, values: Floats) -> None:
        excess = np.maximum(self._lower - values, values - self._upper)
        row, joint = excess.argmax(axis=0), np.arange(len(self._names))
        if excess[row, joint].max() > POSITION_TOLERANCE:  # seldom
            self._count += (excess > POSITION_TOLERANCE).sum(axis=0)
        higher = excess[row, joint] > self._excess
        self._excess[higher] = excess[row, joint][higher]
        self._time[higher] = times[row][higher]
        self._value[higher] = values[row, joint][higher]

    def all(self) -> list[JointPeak]:
        """The peak of each joint, furthest beyond its limit first."""
        middle = (self._lower + self._upper) / 2
        limit = np.where(self._value < middle, self._lower, self._upper)
        columns = (self._time, self._value, limit, self._count)
        return [
            JointPeak(self._names[j], *(column[j].item() for column in columns))
            for j in np.argsort(-self._excess, kind="stable")
        ]

    def beyond(self) -> tuple[JointPeak, ...]:
        """The same of those that pass a limit."""
        return tuple(peak for peak in self.all() if peak.count)


def _target_times(trajectory: Trajectory, interval: Interval, rate: float) -> Iterator[Floats]:
    """Times of the joint targets in the interval, s, a block at a time; of a loop, one round."""
    once = trajectory.period if interval.loop else trajectory.duration - interval.start
    length = once if interval.length is None else min(interval.length, once)
    n_targets = floor(length * rate + 1e-6) + 1  # rounding must not lose the last one
    for first in range(0, n_targets, _BLOCK):
        numbers = np.arange(first, min(first + _BLOCK, n_targets))
        # Nor put it behind the end, where the trajectory rests.
        yield interval.start + np.minimum(numbers / rate, length)


def _others(joints: Sequence[JointPeak]) -> str:
    names = [joint.joint for joint in joints[1:]]
    return f"; also {listed(names, 3)}" if names else ""
