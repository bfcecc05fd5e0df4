"""Limits of a command: of its position, then speed, then torque. Pure.

docs/safety.md explains every limit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.control.reading import STALE, all_finite
from g1stream.errors import ConfigError, SafetyError
from g1stream.motion.limits import POSITION_TOLERANCE
from g1stream.robot.joints import N_JOINTS
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.config import SafetyConfig
    from g1stream.control.reading import Reading
    from g1stream.robot.model import G1
    from g1stream.types import BeyondLimits

__all__ = ["MAX_STEP_TIME", "CommandLimits", "PositionLimit", "SpeedLimit", "TorqueLimit"]

MAX_STEP_TIME: Final = 0.02
"""Maximum step of a joint target, as the time that its joint needs for it at full speed, s.

These are ten periods at 500 Hz: short enough not to disturb a person or a servo, and longer than
the jitter of a loop on an ordinary system. It is also the maximum lag of a motion's target whose
joint is too slow, and the maximum part of a motion that is caught up after a stall.
"""

#: Relative tolerance of a joint's speed, with which a motion exactly at its limit is accepted.
_SPEED_TOLERANCE: Final = 1e-3


class PositionLimit:
    """Clamps the positions of targets to the limits of the joints.

    A clamped joint gets no velocity, and no torque that drives it into the limit. For a joint that
    starts RAMP outside a limit, the limit moves with the ramp from the start pose to its final
    value, so that the command has no step.

    Args:
        robot: the robot with the limits.
        margin: distance that is kept from them, rad.

    Attributes:
        lower, upper: (29,) the limits with the margin, rad.
        clamped: (29,) int64, ticks at which each joint's target was clamped; as in
            `measure_limits`, an excess below `POSITION_TOLERANCE` does not count.

    Raises:
        ConfigError: the margin leaves no range for a joint.
    """

    def __init__(self, robot: G1, margin: float) -> None:
        self.lower, self.upper = robot.lower + margin, robot.upper - margin
        narrowest = int(np.argmin(robot.upper - robot.lower))
        if self.lower[narrowest] > self.upper[narrowest]:
            raise ConfigError(
                f"safety.position_margin = {margin:g} rad leaves no range for "
                f"{robot.joint_names[narrowest]}, whose limits are {robot.lower[narrowest]:g} and "
                f"{robot.upper[narrowest]:g} rad.",
                "Set a margin below half of that range.",
            )
        self._begun: Floats = (robot.lower + robot.upper) / 2
        self.clamped: Ints = np.zeros(N_JOINTS, np.int64)

    def begin(self, q: NDArray[np.floating]) -> None:
        """Set the measured pose (29,) from which RAMP starts, rad; it may violate the limits."""
        self._begun = np.asarray(q, dtype=np.float64).copy()

    def apply(self, asked: Floats, tau: Floats, progress: float = 1.0) -> tuple[Floats, Floats]:
        """Targets and torques within the limits; `asked` and `tau` themselves if they are.

        Args:
            asked: (2, 29) rad and rad/s.
            tau: (29,) N·m.
            progress: progress of the ramp, 0 to 1.
        """
        lower, upper, q = self.lower, self.upper, asked[0]
        if progress < 1.0:
            begun = self._begun
            lower = np.minimum(lower, begun + progress * (lower - begun))
            upper = np.maximum(upper, begun + progress * (upper - begun))
        limited = np.minimum(np.maximum(q, lower), upper)
        moved = limited - q
        if not np.count_nonzero(moved):
            return asked, tau
        self.clamped += np.abs(moved) > POSITION_TOLERANCE
        still = np.where(moved, 0.0, asked[1])
        return np.stack([limited, still]), np.where(moved * tau < 0.0, 0.0, tau)


class SpeedLimit:
    """Limits the step of a target from the last one, and its velocity, to the joint's speed.

    Args:
        robot: the robot with the velocity limits.
        must_reach: a target that its joint cannot reach in time ends the session.

    Attributes:
        fastest: (29,) rad/s.
        limited: (29,) int64, ticks at which the step or velocity was cut.
        fault: why the session must end (the joint that cannot follow its target), or "".
    """

    def __init__(self, robot: G1, *, must_reach: bool) -> None:
        self._names, self._velocity = robot.joint_names, robot.velocity
        self._must_reach = must_reach
        self.fastest: Floats = robot.velocity * (1.0 + _SPEED_TOLERANCE)
        self._reach = np.stack([self.fastest] * 2)  # the largest step, rad, and velocity
        self.limited: Ints = np.zeros(N_JOINTS, np.int64)
        self.fault = ""

    def apply(self, asked: Floats, last: Floats, time: float | Floats) -> Floats:
        """Targets (2, 29) that the joints can reach; `asked` itself if it is.

        Args:
            asked: (2, 29) rad and rad/s.
            last: (2, 29) the positions of the last targets, rad, with zeros for velocities.
            time: time since then, s, of all joints or of each (29,).
        """
        reach, change = self._reach, asked - last
        np.multiply(self.fastest, time, out=reach[0])
        beyond = np.abs(change) > reach
        if not np.count_nonzero(beyond):
            return asked
        limited: Floats = last + np.clip(change, -reach, reach)
        self.limited += beyond.any(axis=0)
        lag = np.abs(asked[0] - limited[0]) / self._velocity
        joint = int(lag.argmax())
        if self._must_reach and lag[joint] > MAX_STEP_TIME and not self.fault:
            self.fault = (
                f"{self._names[joint]} cannot follow its target, {asked[0, joint]:.3f} rad: at "
                f"{self._velocity[joint]:g} rad/s it would be {lag[joint]:.3f} s late "
                f"(limit {MAX_STEP_TIME:g} s)"
            )
        return limited


class TorqueLimit:
    """Moves targets towards the measured state where the servo would exceed its motor's torque.

    The servo's torque is kp (q - measured q) + kd (dq - measured dq) + tau. The excess is taken
    from the first term, by moving the target towards the measured position, and then from the
    second. So the torque is never increased, the servo keeps as much damping as possible, and a
    blocked joint is pushed with the torque limit of its motor. `tau` alone is within the limit. A
    false velocity in one LowState must not become a target velocity.

    Args:
        robot: the robot with the torque limits.

    Attributes:
        limited: (29,) int64, ticks at which the target was moved.
    """

    def __init__(self, robot: G1) -> None:
        self._effort = robot.torque_limit
        self._state = np.zeros((2, N_JOINTS))
        self.limited: Ints = np.zeros(N_JOINTS, np.int64)

    def apply(
        self, asked: Floats, tau: Floats, gains: Floats, measured: Reading, age: float
    ) -> Floats:
        """Targets (2, 29) within the torque limits; `asked` itself if it is.

        Args:
            asked: (2, 29) rad and rad/s.
            tau: (29,) N·m.
            gains: (2, 29) kp and kd, N·m/rad and N·m·s/rad.
            measured: the newest LowState.
            age: its age when the command takes effect, s.
        """
        state = self._state
        state[0], state[1] = measured.q, measured.steady_dq
        state[0] += age * state[1]
        shares = gains * (asked - state)
        torque = shares[0] + shares[1] + tau
        if not np.count_nonzero(np.abs(torque) > self._effort):
            return asked
        excess = torque - np.clip(torque, -self._effort, self._effort)
        self.limited += excess != 0.0
        eased: Floats = asked.copy()
        for row in (0, 1):
            less = np.clip(shares[row], np.minimum(excess, 0.0), np.maximum(excess, 0.0))
            excess = excess - less
            eased[row] -= np.divide(less, gains[row], out=np.zeros(N_JOINTS), where=less != 0.0)
        return eased


class _Sent(NamedTuple):
    """The last command.

    Attributes:
        aimed: (2, 29) its positions before the torque was limited, rad, with zeros for velocities.
        eased: (29,) its positions where the torque was limited; None where it was not.
        rested: (29,) time since the last step of each joint's target, s.
    """

    aimed: Floats
    eased: Floats | None
    rested: Floats


class CommandLimits:
    """Keeps commands within the limits of the robot's joints: position, then speed, then torque.

    Args:
        robot: the robot with the limits.
        config: the margin to the position limits.
        beyond: handling of a motion beyond the limits. With `refuse`, a target that its joint
            cannot follow ends the session; with `anyway`, speed and torque are not limited.
        in_steps: targets are computed at a lower rate than commands, for their torque. A target may
            step by the distance that its joint can move in the time since the last step, up to
            `MAX_STEP_TIME`, and need not be reached.

    Attributes:
        position, speed, torque: the limits, with counts of their changes.

    Raises:
        ConfigError: the margin leaves no range for a joint.
    """

    def __init__(
        self,
        robot: G1,
        config: SafetyConfig,
        beyond: BeyondLimits = "refuse",
        *,
        in_steps: bool = False,
    ) -> None:
        self.position = PositionLimit(robot, config.position_margin)
        self.speed = SpeedLimit(robot, must_reach=beyond == "refuse" and not in_steps)
        self.torque = TorqueLimit(robot)
        self._names = robot.joint_names
        self._anyway, self._in_steps = beyond == "anyway", in_steps
        self._sent = self._next = _Sent(np.zeros((2, N_JOINTS)), None, np.zeros(N_JOINTS))

    def begin(self, q: NDArray[np.floating]) -> None:
        """Set the measured pose (29,) from which RAMP starts, rad; it may violate the limits."""
        self.position.begin(q)
        self._sent = _Sent(_at_rest(q), None, self._sent.rested)

    def apply(
        self,
        asked: Floats,
        tau: Floats,
        *,
        elapsed: float,
        progress: float = 1.0,
        gains: Floats | None = None,
        measured: Reading | None = None,
        age: float = 0.0,
    ) -> tuple[Floats, Floats]:
        """Limit a command.

        Args:
            asked: (2, 29) position and velocity, rad and rad/s.
            tau: (29,) N·m.
            elapsed: time since the previous command, s.
            progress: progress of the ramp, 0 to 1.
            gains: (2, 29) kp and kd, N·m/rad and N·m·s/rad.
            measured: the newest LowState; None: the torque is not limited.
            age: age of `measured` when the command takes effect, s.

        Returns:
            As `asked` and `tau`; `asked` itself if nothing is limited.
        """
        asked, tau = self.position.apply(asked, tau, progress)
        if self._anyway:
            return asked, tau
        last, rested = self._sent, self._sent.rested
        time: float | Floats = min(elapsed, MAX_STEP_TIME)
        if self._in_steps:
            time = np.minimum(rested + elapsed, MAX_STEP_TIME)
            rested = np.where(asked[0] == last.aimed[0], rested + elapsed, 0.0)
        aimed = allowed = self.speed.apply(asked, last.aimed, time)
        if last.eased is not None:
            # A target that returns from the torque limit stays within the position limits, even if
            # the unlimited target is still moving into them.
            allowed = self._within_positions(allowed, asked[0], last.eased)
        if gains is not None and measured and age <= STALE + min(elapsed, MAX_STEP_TIME):
            eased = self.torque.apply(allowed, tau, gains, measured, age)
            if eased is not allowed:
                # Neither a robot beyond a position limit nor a joint that is faster than its
                # velocity limit takes the target there.
                allowed = self._within_positions(eased, allowed[0])
                allowed[1] = np.clip(allowed[1], -self.speed.fastest, self.speed.fastest)
        eased_to = None
        if allowed is not aimed or last.eased is not None:
            # The speed limit also applies to targets that move to the torque limit and back.
            before, reach = last.aimed[0], self.speed.fastest * time
            if last.eased is not None:
                before = last.eased
            allowed = np.stack([np.clip(allowed[0], before - reach, before + reach), allowed[1]])
            eased_to = None if np.array_equal(allowed, aimed) else allowed[0]
        self._next = _Sent(_at_rest(aimed[0]), eased_to, rested)
        return allowed, tau

    def sent(self) -> None:
        """Note that the last command has been sent; the next step starts from it."""
        self._sent = self._next

    def require_finite(self, asked: NDArray[np.floating]) -> None:
        """Check that a command (3, 29) has no NaN or infinity in its q, dq or tau.

        Call it before the limits, which would hide an infinite position.

        Raises:
            SafetyError: a value is not finite; the error names the first one and its joint.
        """
        if all_finite(asked.ravel()):
            return
        row, joint = np.argwhere(~np.isfinite(asked))[0]
        raise SafetyError(
            f"The command for {self._names[joint]} has {('q', 'dq', 'tau')[row]} = "
            f"{asked[row, joint]}.",
            "Check the motion with `g1stream motion`, and the URDF.",
        )

    def _within_positions(self, targets: Floats, *also: Floats) -> Floats:
        """Targets (2, 29) with positions between the limits, widened to the positions `also`."""
        lowest, highest = self.position.lower, self.position.upper
        for q in also:
            lowest, highest = np.minimum(lowest, q), np.maximum(highest, q)
        return np.stack([np.clip(targets[0], lowest, highest), targets[1]])


def _at_rest(q: NDArray[np.floating]) -> Floats:
    """(2, 29) positions `q` (29,) with zeros for velocities."""
    targets = np.zeros((2, N_JOINTS))
    targets[0] = q
    return targets
