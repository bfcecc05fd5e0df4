"""Feed-forward: the velocity and torque of a command, from the model of the robot.

Pure: time and measurements are arguments. docs/tracking.md explains the method.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.reading import STALE, all_finite, is_unit
from g1stream.control.robot_clock import RobotClock
from g1stream.control.sources import Mode, Status
from g1stream.control.stop import Stop
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.joints import N_JOINTS
from g1stream.session.records import FeedForwardChange
from g1stream.types import FeedForwardKind, Floats, Ints

if TYPE_CHECKING:
    from g1stream.control.reading import ImuReading
    from g1stream.control.sources import Moment, Source
    from g1stream.control.targets import Setpoint

__all__ = ["FeedForward"]

_LOGGER = logging.getLogger(__name__)

#: Pelvis rate above which a G1 must have fallen, rad/s.
_MAX_GYROSCOPE: Final = 30.0
#: Time in which the torque fades out, and in again, s.
_FADE: Final = 0.1


class FeedForward:
    """Adds velocity and torque to targets.

    With `dynamics`, a source computes the torque, for example by inverse dynamics of the reference.
    It fades in with RAMP. While the IMU is stale or implausible, or the source has a fault, the
    torque is faded out and the velocity remains.

    Velocities are given in the robot's time, which is slower than the clock in a simulator without
    enough CPU time. The reference's velocity is divided by the time scale, and its acceleration by
    the square of the time scale.

    Args:
        source: computes torques or targets.
        limit: (29,) N·m, the largest torque in either direction; 0 for joints without torque.
        period: time between commands, s.
        preview: time by which the target of a command is ahead of its publish time, s, because it
            takes effect later. None: `delay`, plus a period for a bridge that announces its
            support.
        robot_clock: the robot's time; by default it passes as the computer's.
        delay: known time from receiving a command until the motors apply it, s.
        torque_scale: (29,) ratio of the torque that the motors apply to the commanded torque; the
            torque of the source is divided by it.

    Attributes:
        mode: as decided when RAMP begins.
        status: of the source after the newest command.
        preview: as decided, s; 0 before RAMP begins.
        robot_clock: as given.
        saturated: (29,) int64, ticks at which each joint's torque was at its limit.
        changes: when the torque was switched off and on again, in order.
    """

    def __init__(
        self,
        source: Source,
        *,
        limit: Floats,
        period: float,
        preview: float | None = 0.0,
        robot_clock: RobotClock | None = None,
        delay: float = 0.0,
        torque_scale: Floats | float = 1.0,
    ) -> None:
        self.mode, self.status = Mode(), Status()
        self.preview = 0.0
        self.robot_clock = robot_clock or RobotClock(1.0)
        self.saturated: Ints = np.zeros(N_JOINTS, dtype=np.int64)
        self.changes: list[FeedForwardChange] = []
        self._source = source
        self._set_preview = preview
        self._delay, self._torque_scale = delay, torque_scale
        self._limit = limit
        self._period = period
        self._weight = 1.0  # of the torque, 0 while faded out
        self._fault = ""  # the reported fault
        self._tau = np.zeros(N_JOINTS)

    def stop(self) -> Stop | None:
        """Why the robot has to be damped, or None."""
        fall = self.status.fall
        if not fall and self._source.traits.way_down and self._fault:
            fall = f"the torque that keeps the robot on its feet has faded out: {self._fault}"
        return Stop("fall", fall) if fall else None

    def begin(self, first: Setpoint, announced: str | None, robot: str | None = None) -> None:
        """Choose the preview, and begin the source, whose arguments these are."""
        # The servo of g1stream's bridge runs at the rate of commands. On average it reads a command
        # half a period after its arrival, and holds it for a period. unitree_mujoco's bridges run
        # at another rate or on the arrival of a command, with measurements older by a step.
        # A known delay is from the publish time on, so it has the first half.
        held = self._period / 2.0 if self._delay else self._period
        usual = self._delay + (0.0 if announced is None else held)
        self.preview = usual if self._set_preview is None else self._set_preview
        if self._source.traits.makes_targets:  # the target must be the Reference of a later tick
            self.preview = round(self.preview / self._period) * self._period
        self.mode = self._source.begin(first, announced, robot)
        self.status = self._source.status

    def command(self, moment: Moment) -> Setpoint:
        """The target with the dq and tau of its command."""
        target, own = moment.target, self._source.traits.makes_targets
        scale = self.robot_clock.scale
        if self.mode.kind == "none":
            return target._replace(dq=np.zeros(N_JOINTS))
        if not own:
            target = target.slowed(scale)
        if self.mode.kind == "velocity":
            return target
        # A motion in the robot's time waits while no LowState arrives, so its age does not matter.
        age = 0.0 if own else moment.age
        fault = self.status.fault or _find_fault(moment.measured.imu, age)
        moment = moment._replace(
            target=target, scale=scale, robot_time=self.robot_clock.time / 1e9, fault=fault
        )
        target = self._source.command(moment)
        self.status = self._source.status
        if not fault:
            self._tau = target.tau / self._torque_scale
        self._weight += (-1.0 if fault else 1.0) * self._period / _FADE
        self._weight = min(1.0, max(0.0, self._weight))
        self._log_change(fault, target.motion_time)
        # Within half of the ramp, so that its rest corrects the sag under a partial torque.
        blend = minimum_jerk(2.0 * moment.ramped)[0]
        return target._replace(tau=self._limited(blend * self._weight * self._tau))

    def _log_change(self, fault: str, motion_time: float) -> None:
        """Log when the torque has faded out or in completely; short faults are not logged."""
        if fault and not self._weight and fault != self._fault:
            self._fault = fault
            _LOGGER.warning("feed-forward: velocity only: %s", fault)
        elif self._fault and self._weight == 1.0:
            self._fault = ""
            _LOGGER.warning("feed-forward: dynamics again")
        else:
            return
        kind: FeedForwardKind = "velocity" if self._fault else "dynamics"
        change = FeedForwardChange(motion_time_s=motion_time, kind=kind, reason=self._fault)
        self.changes.append(change)

    def _limited(self, tau: Floats) -> Floats:
        limited: Floats = np.minimum(np.maximum(tau, -self._limit), self._limit)
        if np.count_nonzero(limited != tau):
            self.saturated += (limited != tau) & (self._limit > 0.0)
        return limited


def _find_fault(imu: ImuReading, age: float) -> str:
    """Why no torque can be computed from the newest reading, or ""."""
    if age > STALE:
        return f"LowState is older than {STALE:g} s"
    if not all(map(all_finite, imu)):
        return "the IMU reports NaN or infinity"
    if not is_unit(imu.quat_wxyz):
        return "the IMU quaternion is not of norm 1"
    if max(map(abs, imu.gyroscope.tolist())) > _MAX_GYROSCOPE:
        return f"the gyroscope reports more than {_MAX_GYROSCOPE:g} rad/s"
    return ""
