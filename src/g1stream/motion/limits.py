"""Joint positions and speeds of a streamed motion, compared with the robot's limits.

The stream samples the spline through a motion's frames. Between two frames the spline may be
faster than the frames show, and may exceed a position limit that both frames keep.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from math import ceil, floor
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import ConfigError
from g1stream.text import counted, listed, told_apart
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

The same threshold applies to frames, to the spline and to the targets that are counted as
clamped, so that report and summary agree. Motion files have six decimals, so a joint at a limit
such as 1.614429558 rad is written up to 5e-7 rad beyond it.
"""

#: Clamping a joint by up to this changes the motion by less than a robot's tracking error, rad.
_SLIGHT: Final = 0.02
#: Targets sampled at once. All targets of a long motion need much more memory than its spline.
_BLOCK: Final = 4096


@dataclass(frozen=True)
class Interval:
    """The part of a motion that is played."""

    start: float  # its start as a time in the motion, s
    length: float | None  # s; None: endless
    loop: bool = False  # the motion repeats

    @classmethod
    def from_config(cls, settings: StreamConfig, motion: Motion) -> Interval:
        """The part of a motion that these settings select.

        Raises:
            ConfigError: it starts after the end of the motion.
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

    def cut(self, motion: Motion) -> Motion:
        """The part as a motion of its own."""
        if self.length is None or (not self.start and self.length >= motion.duration):
            return motion
        return motion.trim(self.start, self.start + self.length)

    def frames(self, motion: Motion) -> range:
        """The frames around the interval; all frames of a motion that repeats."""
        if self.loop or self.length is None:
            return range(motion.n_frames)
        first, last = (time * motion.fps for time in (self.start, self.start + self.length))
        return range(floor(first + 1e-6), min(ceil(last - 1e-6) + 1, motion.n_frames))


@dataclass(frozen=True)
class JointPeak:
    """The point where a joint's position or speed is furthest beyond a limit, or closest to it."""

    joint: str
    time: float  # s from frame 0
    value: float  # position, rad, or speed in either direction, rad/s
    limit: float  # the nearest or exceeded limit
    count: int  # frames or streamed targets beyond a limit


@dataclass(frozen=True)
class LimitReport:
    """Joint speeds, and targets beyond position limits, of a streamed motion."""

    motion: str
    duration: float  # s, from frame 0 to the last frame
    rate: float  # joint targets per second, Hz
    position_margin: float  # position limits are narrowed by this, rad
    speeds: tuple[JointPeak, ...]  # highest of each joint, largest fraction of its limit first
    held: tuple[JointPeak, ...]  # joints with targets clamped to a position limit, furthest first

    @property
    def too_fast(self) -> tuple[JointPeak, ...]:
        return tuple(speed for speed in self.speeds if speed.count)

    @property
    def n_held(self) -> int:
        return sum(joint.count for joint in self.held)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A warning for positions and one for speeds, if a limit is exceeded."""
        warnings = []
        if self.held:
            worst = self.held[0]
            margin = f" less a margin of {self.position_margin:g}" if self.position_margin else ""
            value, limit = told_apart(worst.value, worst.limit)
            warnings.append(
                f"{self.motion} moves {worst.joint} to {value} rad "
                f"{self._when(worst.time)}, limit {limit}{margin}{_others(self.held)}. "
                f"{counted(self.n_held, 'joint target')} at {self.rate:g} Hz clamped to the limit."
            )
        if self.too_fast:
            fastest = self.too_fast[0]
            warnings.append(
                f"{self.motion} moves {fastest.joint} at {fastest.value:.1f} rad/s "
                f"{self._when(fastest.time)}, limit {fastest.limit:g}{_others(self.too_fast)}. "
                "Joints that cannot follow lag behind."
            )
        return tuple(warnings)

    @property
    def events(self) -> tuple[tuple[int, str], ...]:
        """The warnings with their log levels: INFO for targets slightly beyond a limit."""
        slight = self.held and abs(self.held[0].value - self.held[0].limit) <= _SLIGHT
        return tuple(
            (logging.INFO if slight and not number else logging.WARNING, text)
            for number, text in enumerate(self.warnings)
        )

    def _when(self, time: float) -> str:
        if time > self.duration:  # only in a loop
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
    """Compare every streamed joint target with the limits.

    Args:
        trajectory: spline of a motion with the robot's joints.
        robot: robot with the limits.
        interval: the part to be played, at most one round of a loop; the whole motion if None.
        rate: joint targets per second, Hz, at the times start + i / rate.
        position_margin: distance from the position limits, as `safety.position_margin`, rad.
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
    """The joints beyond a position limit in an interval's frames, and the fastest joint.

    Speeds are central differences of the whole motion's frames, as most tools compute them.
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
    """The peak of each joint so far, from values (N, J) at times (N,)."""

    def __init__(self, robot: G1, lower: Floats, upper: Floats) -> None:
        self._names, self._lower, self._upper = robot.joint_names, lower, upper
        self._excess = np.full(len(lower), -np.inf)
        self._time, self._value = np.zeros((2, len(lower)))
        self._count = np.zeros(len(lower), dtype=np.int64)

    def update(self, times: Floats, values: Floats) -> None:
        excess = np.maximum(self._lower - values, values - self._upper)
        row, joint = excess.argmax(axis=0), np.arange(len(self._names))
        if excess[row, joint].max() > POSITION_TOLERANCE:  # rare
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
        """The peaks of the joints that exceed a limit."""
        return tuple(peak for peak in self.all() if peak.count)


def _target_times(trajectory: Trajectory, interval: Interval, rate: float) -> Iterator[Floats]:
    """Times of the joint targets in the interval, in blocks, s; one round of a loop."""
    once = trajectory.period if interval.loop else trajectory.duration - interval.start
    length = once if interval.length is None else min(interval.length, once)
    n_targets = floor(length * rate + 1e-6) + 1  # rounding must not lose the last one
    for first in range(0, n_targets, _BLOCK):
        numbers = np.arange(first, min(first + _BLOCK, n_targets))
        # Rounding must not move it past the end either, where the trajectory rests.
        yield interval.start + np.minimum(numbers / rate, length)


def _others(joints: Sequence[JointPeak]) -> str:
    names = [joint.joint for joint in joints[1:]]
    return f"; also {listed(names, 3)}" if names else ""
