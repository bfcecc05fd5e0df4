"""From the phase and the motion to what is asked of each joint and the root; pure."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.motion.blend import COAST, MINIMUM_JERK_PEAK, coast, minimum_jerk
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import quat_from_axis_angle, quat_mul
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.extras.feet.squat import Squat
    from g1stream.motion.spline import TrajectoryPoint
    from g1stream.motion.trajectory import Trajectory

__all__ = ["LOWERED", "Ramp", "Target", "Targets"]

LOWERED: Final = 0.9
"""Share of RAMP in which a lifted pelvis is lowered."""

_N: Final = N_JOINTS
_NO_TORQUE: Final = np.zeros(N_JOINTS)


class _Part:
    """Named access to a range of a target's values."""

    def __init__(self, start: int, length: int) -> None:
        self._where = slice(start, start + length)

    def __get__(self, target: Any, _: type | None = None) -> Floats:
        part: Floats = target.values[self._where]
        return part


#: Parts of `Target.values` that have the units of a velocity, and of an acceleration.
_VELOCITIES: Final = (slice(_N, 2 * _N), slice(4 * _N + 7, 4 * _N + 13))
_ACCELERATIONS: Final = (slice(2 * _N, 3 * _N), slice(4 * _N + 13, 4 * _N + 19))


@dataclass(frozen=True)
class Target:
    """The desired state of joints and root at one instant, as one array with named parts.

    One array, so that the loop copies it into a message in one step.

    Attributes:
        motion_time: s since the motion's first frame.
        values: (135,) the parts below in order; the fields of the Reference message come first.
        q, dq, ddq, tau: (29,) rad, rad/s, rad/s^2, N·m, motor order.
        root_pos: (3,) m, world.
        root_quat_wxyz: (4,) pelvis to world.
        root_lin_vel: (3,) m/s, world.
        root_ang_vel: (3,) rad/s, pelvis frame.
        root_lin_acc: (3,) m/s^2, world, without gravity; not published.
        root_ang_acc: (3,) rad/s^2, pelvis frame, the time derivative of `root_ang_vel`; not
            published.
        published: (129,) all parts before those two.
    """

    motion_time: float
    values: Floats

    q = _Part(0, _N)
    dq = _Part(_N, _N)
    ddq = _Part(2 * _N, _N)
    tau = _Part(3 * _N, _N)
    root_pos = _Part(4 * _N, 3)
    root_quat_wxyz = _Part(4 * _N + 3, 4)
    root_lin_vel = _Part(4 * _N + 7, 3)
    root_ang_vel = _Part(4 * _N + 10, 3)
    root_lin_acc = _Part(4 * _N + 13, 3)
    root_ang_acc = _Part(4 * _N + 16, 3)
    published = _Part(0, 4 * _N + 13)

    @property
    def q_dq(self) -> Floats:
        """(2, 29) q and dq."""
        return self.values[: 2 * _N].reshape(2, _N)

    @staticmethod
    def of(time: float, point: TrajectoryPoint) -> Target:
        """The target at motion time `time`, s, from a sample of the trajectory; zero torque."""
        values = np.concatenate(
            (
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
        )
        values.setflags(write=False)  # one target is shared by several callers
        return Target(time, values)

    def replace(self, **parts: Floats | float) -> Target:
        """A copy with other values in the named parts."""
        other = Target(self.motion_time, self.values.copy())
        for name, values in parts.items():
            getattr(other, name)[:] = values
        return other

    def slowed(self, scale: float) -> Target:
        """The target in a time that passes `scale` times as fast; the same object if that is 1."""
        if scale == 1.0:
            return self
        values = self.values.copy()
        for part in _VELOCITIES:
            values[part] *= 1.0 / scale
        for part in _ACCELERATIONS:
            values[part] *= 1.0 / scale**2
        return Target(self.motion_time, values)

    def at_rest(self) -> Target:
        """A copy with the same pose and zero velocity, acceleration and torque."""
        moving = ("root_lin_vel", "root_ang_vel", "root_lin_acc", "root_ang_acc")
        return self.replace(dq=0.0, ddq=0.0, tau=0.0, **dict.fromkeys(moving, 0.0))


class Ramp(NamedTuple):
    """The way from the measured pose to the first frame.

    Attributes:
        length: s.
        joint: the one with the longest way.
        distance: of that joint, rad, signed.
    """

    length: float
    joint: str
    distance: float

    @property
    def peak_speed(self) -> float:
        """Highest speed of that joint, rad/s; its speed at the first frame comes on top."""
        return MINIMUM_JERK_PEAK * abs(self.distance) / self.length

    @classmethod
    def of(cls, distance: Floats, least: float, speed: float) -> Ramp:
        """The shortest ramp of at least `least` seconds in which no joint passes `speed`, rad/s.

        Args:
            distance: (29,) from the measured pose to the first frame, rad.
            least: s.
            speed: rad/s.
        """
        joint = int(np.abs(distance).argmax())
        furthest = float(distance[joint])
        length = max(least, MINIMUM_JERK_PEAK * abs(furthest) / speed)
        return cls(length, JOINT_NAMES[joint], furthest)


class Targets:
    """The target of each phase at any time.

    The target velocity is continuous: RAMP ends with the velocity of the first frame of PLAY, and
    HOLD brings the velocity of the last one to zero.

    Args:
        trajectory: the motion.
        start: motion time at which PLAY begins, s.
        play: how much of the motion is played, s; None: until stopped.
        ramp: shortest length of RAMP, s.
        ramp_speed: highest speed of a joint on the way to the first frame, rad/s.
        played: (29,) which joints play the motion, all if None; the others keep the pose from which
            RAMP starts.
        lift: m by which the pelvis is higher when RAMP begins: a simulator that holds it there
            lowers the robot onto its feet with it.
        squat: the way down, for a robot that is on its feet.
        hold: s of HOLD before that way down.

    Attributes:
        first: the target at `start`.
        ramp_end: when RAMP ends, s after it began. It may be set to later than `begin` sets it:
            RAMP then rests at the first frame until `COAST` before that.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        *,
        start: float,
        play: float | None,
        ramp: float,
        ramp_speed: float = inf,
        played: NDArray[np.bool_] | None = None,
        lift: float = 0.0,
        squat: Squat | None = None,
        hold: float = 0.0,
    ) -> None:
        self._trajectory = trajectory
        self._start = start
        self._play = play
        self._least_ramp = self._ramp = self.ramp_end = ramp
        self._ramp_speed = ramp_speed
        self._played = None if played is None or played.all() else played
        self._lift = np.array([0.0, 0.0, lift])
        self._squat, self._hold = squat, max(hold, COAST)
        self._down = False
        self._from: Floats | None = None
        self.first = Target.of(start, trajectory.sample(start))
        self._last = self.first.at_rest()
        self._sampled = self.first

    def begin(self, q: NDArray[np.floating]) -> Ramp:
        """Set the measured pose (29,) from which RAMP starts, rad, and return the ramp."""
        self._from = np.asarray(q, dtype=np.float64).copy()
        self.first = self._sampled = self._of_played(self.first)
        ramp = Ramp.of(self.first.q - self._from, self._least_ramp, self._ramp_speed)
        self._ramp = self.ramp_end = ramp.length
        return ramp

    def at(self, phase: Phase, elapsed: float) -> Target:
        """The target `elapsed` seconds into a phase.

        Args:
            phase: RAMP, PLAY, HOLD or DAMP.
            elapsed: s since the phase began.
        """
        if phase is Phase.PLAY:
            self._last = self._playing(elapsed)
        elif phase is Phase.RAMP:
            self._last = self._ramping(elapsed)
        elif phase is Phase.HOLD:
            self._last = self._holding(elapsed)
        else:
            self._last = self._last.at_rest()
        return self._last

    @property
    def squats(self) -> bool:
        """Whether HOLD ends in a squat."""
        return self._squat is not None

    def may_end(self) -> bool:
        """Whether the newest target is one to squat down from: both feet stand."""
        return self._squat is not None and self._squat.possible(self._last)

    def end(self, play: float, hold: float) -> None:
        """PLAY has ended, or ends, after `play` s, and the way down begins `hold` s later."""
        self._play, self._hold = play, max(hold, COAST)

    def _holding(self, elapsed: float) -> Target:
        if self._squat is None or elapsed < self._hold:
            return _coasting(self._playing(self._play or 0.0), *coast(elapsed, COAST))
        if not self._down:
            self._down = True
            self._squat.begin(self._playing(self._play or 0.0).at_rest())
        return self._squat.at(elapsed - self._hold)

    def _playing(self, elapsed: float) -> Target:
        time = self._start + (elapsed if self._play is None else min(elapsed, self._play))
        # With a preview of one period, each time is asked for twice in a row.
        if time != self._sampled.motion_time:
            self._sampled = self._of_played(Target.of(time, self._trajectory.sample(time)))
        return self._sampled

    def _of_played(self, target: Target) -> Target:
        """The target with the joints that are not played at rest where RAMP starts."""
        played = self._played
        if played is None or self._from is None:
            return target
        return target.replace(
            q=np.where(played, target.q, self._from),
            dq=np.where(played, target.dq, 0.0),
            ddq=np.where(played, target.ddq, 0.0),
        )

    def _ramping(self, elapsed: float) -> Target:
        if self._from is None:
            raise RuntimeError("RAMP has no start pose: call begin() first")
        left = max(0.0, self.ramp_end - elapsed)
        way, rate, acceleration = coast(left, min(COAST, self._ramp))  # braking in reverse
        goal = _coasting(self.first, -way, rate, -acceleration)
        progress, speed, change = minimum_jerk(elapsed / self._ramp)
        distance = self.first.q - self._from
        lifted = 1.0 - minimum_jerk(elapsed / (LOWERED * self._ramp))[0]
        return goal.replace(
            root_pos=goal.root_pos + lifted * self._lift,
            q=self._from + progress * distance - way * self.first.dq,
            dq=goal.dq + speed / self._ramp * distance,
            ddq=goal.ddq + change / self._ramp**2 * distance,
        )


def _coasting(target: Target, way: float, rate: float, acceleration: float) -> Target:
    """A target displaced along its own velocity by `way` seconds, with its velocity scaled."""
    turn, quat = target.root_ang_vel, target.root_quat_wxyz
    if way and (angle := float(np.linalg.norm(turn))):
        quat = quat_mul(quat, quat_from_axis_angle(turn / angle, np.asarray(way * angle)))
    return target.replace(
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
