"""Targets of all joints and the root at any time of each phase. Pure."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import numpy as np

from g1stream.motion.blend import COAST, MINIMUM_JERK_PEAK, coast, minimum_jerk
from g1stream.motion.spline import TrajectoryPoint
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import quat_from_axis_angle, quat_mul
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from g1stream.config import StreamConfig
    from g1stream.motion.trajectory import Trajectory

__all__ = ["COAST_NS", "LOWERED", "Ramp", "Setpoint", "Targets", "Timing", "WayDown"]

LOWERED: Final = 0.9
"""Share of RAMP in which a lifted pelvis is lowered."""

#: Height of a lifted pelvis above its target, m; the length of a leg differs by less between
#: stretched and lowest squat.
_LIFT: Final = 0.4

COAST_NS: Final = round(COAST * 1e9)
"""Time, ns, in which the velocity rises at the end of RAMP, and falls to zero in HOLD."""

_NO_MOTION: Final = np.zeros(3)
_NO_TORQUE: Final = np.zeros(N_JOINTS)
for _zeros in (_NO_MOTION, _NO_TORQUE):
    _zeros.setflags(write=False)  # all targets at rest share them


class Setpoint(NamedTuple):
    """The desired state of joints and root at one instant; its arrays are read-only.

    Attributes:
        motion_time: time since the motion's first frame, s.
        q, dq, ddq, tau: (29,) rad, rad/s, rad/s^2, N·m, motor order.
        root_pos: (3,) m, world.
        root_quat_wxyz: (4,) pelvis to world.
        root_lin_vel: (3,) m/s, world.
        root_ang_vel: (3,) rad/s, pelvis frame.
        root_lin_acc: (3,) m/s^2, world, without gravity; not published.
        root_ang_acc: (3,) rad/s^2, pelvis frame, the time derivative of `root_ang_vel`; not
            published.
    """

    motion_time: float
    q: Floats
    dq: Floats
    ddq: Floats
    tau: Floats
    root_pos: Floats
    root_quat_wxyz: Floats
    root_lin_vel: Floats
    root_ang_vel: Floats
    root_lin_acc: Floats
    root_ang_acc: Floats

    @classmethod
    def from_point(cls, time: float, point: TrajectoryPoint) -> Setpoint:
        """Make a target at motion time `time`, s, from a trajectory sample, with zero torque."""
        for array in point:
            array.setflags(write=False)  # one target is shared by several callers
        return cls(
            time,
            point.joint_pos,
            point.joint_vel,
            point.joint_acc,
            _NO_TORQUE,
            point.root_pos,
            point.root_quat_wxyz,
            point.root_lin_vel,
            point.root_ang_vel,
            point.root_lin_acc,
            point.root_ang_acc,
        )

    def slowed(self, scale: float) -> Setpoint:
        """The target with rates divided by a time scale; the same object if the scale is 1."""
        if scale == 1.0:
            return self
        per_s, per_s2 = 1.0 / scale, 1.0 / scale**2
        return self._replace(
            dq=per_s * self.dq,
            ddq=per_s2 * self.ddq,
            root_lin_vel=per_s * self.root_lin_vel,
            root_ang_vel=per_s * self.root_ang_vel,
            root_lin_acc=per_s2 * self.root_lin_acc,
            root_ang_acc=per_s2 * self.root_ang_acc,
        )

    def at_rest(self) -> Setpoint:
        """A copy with the same pose and zero velocity, acceleration and torque."""
        return self._replace(
            dq=_NO_TORQUE,
            ddq=_NO_TORQUE,
            tau=_NO_TORQUE,
            root_lin_vel=_NO_MOTION,
            root_ang_vel=_NO_MOTION,
            root_lin_acc=_NO_MOTION,
            root_ang_acc=_NO_MOTION,
        )


class Ramp(NamedTuple):
    """The way from the measured pose to the first frame.

    Attributes:
        length: duration, ns.
        joint: the joint with the longest distance.
        distance: signed distance of that joint, rad.
    """

    length: int
    joint: str
    distance: float

    @property
    def peak_speed(self) -> float:
        """Maximum speed of that joint, rad/s, without its speed at the first frame."""
        return MINIMUM_JERK_PEAK * abs(self.distance) / (self.length / 1e9)

    @classmethod
    def for_distance(cls, distance: Floats, least: int, speed: float) -> Ramp:
        """Make the shortest ramp within a minimum duration and a maximum joint speed.

        Args:
            distance: (29,) from the measured pose to the first frame, rad.
            least: minimum duration, ns.
            speed: maximum joint speed, rad/s.
        """
        joint = int(np.abs(distance).argmax())
        furthest = float(distance[joint])
        length = max(least, round(1e9 * MINIMUM_JERK_PEAK * abs(furthest) / speed))
        return cls(length, JOINT_NAMES[joint], furthest)


class Timing(NamedTuple):
    """Length of each phase, ns.

    Attributes:
        wait: WAIT ends the session after this time.
        ramp: length of the way to the first frame.
        play: length of PLAY; None: until stopped.
        hold, damp: length of these phases.
        settle: minimum length of WAIT, so that other publishers of LowCmd are discovered.
        awaited: time by which RAMP is extended; it rests at the first frame until `COAST_NS` before
            its end.
        way_down: time by which HOLD is extended, in which a robot on its feet goes down.
    """

    wait: int
    ramp: int
    play: int | None
    hold: int
    damp: int
    settle: int = 0
    awaited: int = 0
    way_down: int = 0

    @classmethod
    def from_config(cls, settings: StreamConfig, play: float | None, settle: int) -> Timing:
        """Make the timing from settings; `play` in s, `settle` in ns."""
        wait, ramp, hold, damp = (
            round(1e9 * seconds)
            for seconds in (settings.wait, settings.ramp, settings.hold, settings.damp)
        )
        return cls(wait, ramp, None if play is None else round(1e9 * play), hold, damp, settle)


class WayDown(Protocol):
    """Interface of the motion in which a robot on its feet goes down before it is damped.

    Attributes:
        length: duration, s.
    """

    length: float

    def possible(self, target: Setpoint) -> bool:
        """Whether the way down can begin at a target."""

    def plan(self, standing: Setpoint) -> Callable[[float, Floats], Setpoint]:
        """Plan the way down from a target at rest.

        Returns:
            A function of the time since the way down began, s, and the joints (29,) of the previous
            target, rad, that returns the target.
        """


class Targets:
    """The target of each phase at any time.

    The target velocity is continuous: RAMP ends with the velocity of the first frame of PLAY, and
    HOLD brings the velocity of the last one to zero.

    Args:
        trajectory: the motion.
        start: motion time at which PLAY begins, s.
        moved: (29,) joints that the trajectory moves; the others keep the pose from which RAMP
            starts.
        way_down: motion with which HOLD ends; None: no motion. With it, RAMP begins with a lifted
            pelvis. A simulator that holds the pelvis there lowers the robot onto its feet.
        block: ticks of PLAY that are sampled together, as ns since the first one.

    Attributes:
        first: the target at `start`.
        way_down: as given.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        *,
        start: float,
        moved: NDArray[np.bool_],
        way_down: WayDown | None = None,
        block: range = range(1),
    ) -> None:
        self._trajectory, self._block = trajectory, block
        self._start = start
        self._moved = None if moved.all() else moved
        self._lift = np.array([0.0, 0.0, _LIFT if way_down else 0.0])
        self.way_down = way_down
        self._from: Floats | None = None
        self.first = Setpoint.from_point(start, trajectory.sample(start))
        # With a preview of one period, each time is needed twice in a row.
        self._sampled: dict[float, Setpoint] = {}
        self._planned = lru_cache(maxsize=1)(self._plan_way_down)

    def begin(self, q: NDArray[np.floating]) -> Floats:
        """Set the measured pose (29,) where RAMP starts, rad; return the distance to `first`."""
        self._from = np.asarray(q, dtype=np.float64).copy()
        self.first = self._of_moved(self.first)
        self._sampled = {}
        return self.first.q - self._from

    def at(self, phase: Phase, elapsed: int, timing: Timing, last: Setpoint) -> Setpoint:
        """The target `elapsed` ns into a phase.

        Args:
            phase: RAMP, PLAY, HOLD or DAMP.
            elapsed: ns since the phase began.
            timing: length of each phase.
            last: the previous target, which DAMP keeps, and from which the way down continues.
        """
        if phase is Phase.PLAY:
            return self._playing(elapsed, timing)
        if phase is Phase.RAMP:
            return self._ramping(elapsed, timing)
        if phase is Phase.HOLD:
            return self._holding(elapsed, timing, last)
        return last.at_rest()

    def _time(self, elapsed: int, timing: Timing) -> float:
        """The motion time `elapsed` ns into PLAY, s."""
        return self._start + (elapsed if timing.play is None else min(elapsed, timing.play)) / 1e9

    def _playing(self, elapsed: int, timing: Timing) -> Setpoint:
        time = self._time(elapsed, timing)
        if time not in self._sampled:
            follows = self._time(elapsed - self._block.step, timing) in self._sampled
            block = self._block if follows else range(1)
            self._sample([self._time(elapsed + later, timing) for later in block])
        return self._sampled[time]

    def _sample(self, times: list[float]) -> None:
        """Replace what is sampled by the targets at some times in the motion, s."""
        points = [self._trajectory.sample(times[0])]
        if len(times) > 1:
            rows = zip(*self._trajectory.sample_many(times), strict=True)
            points = [TrajectoryPoint(*row) for row in rows]
        made = map(Setpoint.from_point, times, points)
        self._sampled = dict(zip(times, map(self._of_moved, made), strict=True))

    def _of_moved(self, target: Setpoint) -> Setpoint:
        """The target with joints that are not moved at rest in the pose where RAMP starts."""
        moved = self._moved
        if moved is None or self._from is None:
            return target
        return target._replace(
            q=np.where(moved, target.q, self._from),
            dq=np.where(moved, target.dq, 0.0),
            ddq=np.where(moved, target.ddq, 0.0),
        )

    def _ramping(self, elapsed: int, timing: Timing) -> Setpoint:
        if self._from is None:
            raise RuntimeError("RAMP has no start pose: call begin() first")
        left, length = max(0, timing.ramp + timing.awaited - elapsed) / 1e9, timing.ramp / 1e9
        way, rate, acceleration = coast(left, min(COAST, length))  # braking in reverse
        goal = _coasting(self.first, -way, rate, -acceleration)
        passed = elapsed / timing.ramp
        progress, speed, change = minimum_jerk(passed)
        distance = self.first.q - self._from
        lifted = 1.0 - minimum_jerk(passed / LOWERED)[0]
        return goal._replace(
            root_pos=goal.root_pos + lifted * self._lift,
            q=self._from + progress * distance - way * self.first.dq,
            dq=goal.dq + speed / length * distance,
            ddq=goal.ddq + change / length**2 * distance,
        )

    def _holding(self, elapsed: int, timing: Timing, last: Setpoint) -> Setpoint:
        end = self._playing(timing.play or 0, timing)
        if self.way_down is None or elapsed < timing.hold:
            return _coasting(end, *coast(elapsed / 1e9, COAST))
        return self._planned(end.motion_time)((elapsed - timing.hold) / 1e9, last.q)

    def _plan_way_down(self, time: float) -> Callable[[float, Floats], Setpoint]:
        if self.way_down is None:
            raise RuntimeError("there is no way down")
        return self.way_down.plan(self._sampled[time].at_rest())


def _coasting(target: Setpoint, way: float, rate: float, acceleration: float) -> Setpoint:
    """A target displaced along its own velocity by `way` seconds, with its velocity scaled."""
    turn, quat = target.root_ang_vel, target.root_quat_wxyz
    if way and (angle := float(np.linalg.norm(turn))):
        quat = quat_mul(quat, quat_from_axis_angle(turn / angle, np.asarray(way * angle)))
    return target._replace(
        q=target.q + way * target.dq,
        dq=rate * target.dq,
        ddq=acceleration * target.dq,
        root_pos=target.root_pos + way * target.root_lin_vel,
        root_quat_wxyz=quat,
        root_lin_vel=rate * target.root_lin_vel,
        root_ang_vel=rate * turn,
        root_lin_acc=acceleration * target.root_lin_vel,
        root_ang_acc=acceleration * turn,
    )
