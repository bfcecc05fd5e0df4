"""Limits of a command: of its position, then speed, then torque. Pure.

docs/safety.md explains every limit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.reading import STALE, all_finite
from g1stream.errors import ConfigError, SafetyError
from g1stream.motion.limits import POSITION_TOLERANCE
from g1stream.robot.joints import N_JOINTS
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.config import SafetyConfig
    from g1stream.control.reading import Reading
    from g1stream.robot.model import G1
    from g1stream.types import BeyondLimits

__all__ = ["MAX_STEP_TIME", "CommandLimits"]

MAX_STEP_TIME: Final = 0.02
"""Maximum step of a joint target, as the time that its joint needs for it at full speed, s.

These are ten periods at 500 Hz: short enough not to disturb a person or a servo, and longer than
the jitter of a loop on an ordinary system. It is also the maximum lag of a motion's target whose
joint is too slow, and the maximum part of a motion that is caught up after a stall.
"""

#: Relative tolerance of a joint's speed, with which a motion exactly at its limit is accepted.
_SPEED_TOLERANCE: Final = 1e-3


class CommandLimits:
    """Keeps commands within the limits of the robot's joints.

    Positions and velocities are the rows of one array (2, 29), which is twice as fast as two
    arrays.

    Args:
        robot: the robot with the limits.
        config: the margin to the position limits.
        beyond: handling of a motion beyond the limits. With `refuse`, a target that its joint
            cannot follow ends the session; with `anyway`, speed and torque are not limited.
        in_steps: targets are computed at a lower rate than commands, for their torque. A target may
            step by the distance that its joint can move in the time since the last step, up to
            `MAX_STEP_TIME`, and need not be reached.

    Attributes:
        clamped: (29,) int64, ticks at which each joint's target was clamped to a position limit; as
            in `measure_limits`, an excess below `POSITION_TOLERANCE` does not count.
        speed_limited: (29,) ticks at which the step or velocity was cut to the velocity limit.
        torque_limited: (29,) ticks at which the target was moved towards the measured position.
        fault: why the session must end (the joint that cannot follow its target), or "".

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
        self._names = robot.joint_names
        self._lower = robot.lower + config.position_margin
        self._upper = robot.upper - config.position_margin
        narrowest = int(np.argmin(robot.upper - robot.lower))
        if self._lower[narrowest] > self._upper[narrowest]:
            raise ConfigError(
                f"safety.position_margin = {config.position_margin:g} rad leaves no range for "
                f"{self._names[narrowest]}, whose limits are {robot.lower[narrowest]:g} and "
                f"{robot.upper[narrowest]:g} rad.",
                "Set a margin below half of that range.",
            )
        self._velocity, self._effort = robot.velocity, robot.torque_limit
        self._beyond = beyond
        self._in_steps = in_steps
        #: Time since the last step of each joint's target, s; for `in_steps`.
        self._rested, self._next_rested = np.zeros((2, N_JOINTS))
        self._begun: Floats = (robot.lower + robot.upper) / 2
        #: Largest step, rad, and velocity, rad/s.
        self._reach = np.stack([robot.velocity] * 2) * (1.0 + _SPEED_TOLERANCE)
        self._fastest = self._reach[1].copy()
        #: Positions of the last command, with zeros for velocities, before the torque was limited.
        self._aimed, self._next_aimed = np.zeros((2, 2, N_JOINTS))
        #: Positions of the last command where the torque was limited.
        self._eased: Floats | None = None
        self._next_eased: Floats | None = None
        self._state = np.zeros((2, N_JOINTS))
        self.clamped, self.speed_limited, self.torque_limited = np.zeros((3, N_JOINTS), np.int64)
        self.fault = ""

    def begin(self, q: NDArray[np.floating]) -> None:
        """Set the measured pose (29,) from which RAMP starts, rad; it may violate the limits."""
        self._begun = np.asarray(q, dtype=np.float64).copy()
        self._aimed[0], self._eased = q, None

    def apply(
        self,
        asked: Floats,
        tau: Floats,
        *,
        elapsed: float,
        ramped: float = 1.0,
        gains: Floats | None = None,
        measured: Reading | None = None,
        age: float = 0.0,
    ) -> tuple[Floats, Floats]:
        """Limit a command in position, then in speed, then in torque.

        Args:
            asked: (2, 29) position and velocity, rad and rad/s.
            tau: (29,) N·m.
            elapsed: time since the previous command, s.
            ramped: progress of the ramp, 0 to 1.
            gains: (2, 29) kp and kd, N·m/rad and N·m·s/rad.
            measured: the newest LowState; None: the torque is not limited.
            age: age of `measured` when the command takes effect, s.

        Returns:
            As `asked` and `tau`; `asked` itself if nothing is limited.
        """
        q = asked[0]
        limited = self.limit_position(q, ramped)
        if limited is not q:
            dq, tau = self.keep_inward(q - limited, asked[1], tau)
            asked = np.stack([limited, dq])
        if self._beyond == "anyway":
            return asked, tau
        time: float | Floats = min(elapsed, MAX_STEP_TIME)
        if self._in_steps:
            rested = self._rested + elapsed
            time = np.minimum(rested, MAX_STEP_TIME)
            self._next_rested = np.where(asked[0] == self._aimed[0], rested, 0.0)
        np.multiply(self._fastest, time, out=self._reach[0])
        aimed = eased = self._limit_speed(asked)
        if self._eased is not None:
            # A target that returns from the torque limit stays within the position limits, even if
            # the unlimited target is still moving into them.
            lowest = np.minimum(np.minimum(self._lower, asked[0]), self._eased)
            highest = np.maximum(np.maximum(self._upper, asked[0]), self._eased)
            eased = np.stack([np.clip(aimed[0], lowest, highest), aimed[1]])
        if gains is not None and measured and age <= STALE + min(elapsed, MAX_STEP_TIME):
            eased = self._limit_torque(eased, tau, gains, measured, age)
        self._next_eased = None
        if eased is not aimed or self._eased is not None:
            # The speed limit also applies to targets that move to the torque limit and back.
            before, reach = self._aimed[0] if self._eased is None else self._eased, self._reach[0]
            eased = np.stack([np.clip(eased[0], before - reach, before + reach), eased[1]])
            if not np.array_equal(eased, aimed):
                self._next_eased = eased[0]
        self._next_aimed[0] = aimed[0]
        return eased, tau

    def sent(self) -> None:
        """Note that the last command has been sent; the next step starts from it."""
        self._aimed, self._next_aimed = self._next_aimed, self._aimed
        self._eased, self._rested = self._next_eased, self._next_rested

    def limit_position(self, q: Floats, ramped: float = 1.0) -> Floats:
        """Clamp joint targets (29,) to the limits, rad; returns `q` itself if none is clamped.

        For a joint that starts RAMP outside a limit, the limit moves with the ramp from the start
        pose to its final value, so that the command has no step.

        Args:
            q: the targets, rad.
            ramped: progress of the ramp, 0 to 1.
        """
        lower, upper = self._lower, self._upper
        if ramped < 1.0:
            begun = self._begun
            lower = np.minimum(lower, begun + ramped * (lower - begun))
            upper = np.maximum(upper, begun + ramped * (upper - begun))
        limited: Floats = np.minimum(np.maximum(q, lower), upper)
        moved = limited - q
        if not np.count_nonzero(moved):
            return q
        self.clamped += np.abs(moved) > POSITION_TOLERANCE
        return limited

    @staticmethod
    def keep_inward(excess: Floats, dq: Floats, tau: Floats) -> tuple[Floats, Floats]:
        """Velocities and torques (29,) that do not drive a clamped joint into its limit.

        Args:
            excess: distance of each target above its upper limit, rad; negative below the lower.
            dq: target velocities, rad/s.
            tau: feed-forward torques, N·m.

        Returns:
            dq, zero for clamped joints, and tau, zero for clamped joints that it pushes outward.
        """
        return np.where(excess, 0.0, dq), np.where(excess * tau > 0.0, 0.0, tau)

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

    def _limit_speed(self, asked: Floats) -> Floats:
        """Targets (2, 29) that the joints can reach from the last ones; `asked` itself if it is."""
        change = asked - self._aimed
        beyond = np.abs(change) > self._reach
        if not np.count_nonzero(beyond):
            return asked
        limited: Floats = self._aimed + np.clip(change, -self._reach, self._reach)
        self.speed_limited += beyond.any(axis=0)
        lag = np.abs(asked[0] - limited[0]) / self._velocity
        joint = int(lag.argmax())
        must_follow = self._beyond == "refuse" and not self._in_steps
        if must_follow and lag[joint] > MAX_STEP_TIME and not self.fault:
            self.fault = (
                f"{self._names[joint]} cannot follow its target, {asked[0, joint]:.3f} rad: at "
                f"{self._velocity[joint]:g} rad/s it would be {lag[joint]:.3f} s late "
                f"(limit {MAX_STEP_TIME:g} s)"
            )
        return limited

    def _limit_torque(
        self, asked: Floats, tau: Floats, gains: Floats, measured: Reading, age: float
    ) -> Floats:
        """Targets (2, 29) within the torque limits of the motors; `asked` itself if it is.

        The servo's torque is kp (q - measured q) + kd (dq - measured dq) + tau. The excess is taken
        from the first term, by moving the target towards the measured position, and then from the
        second. So the torque is never increased, the servo keeps as much damping as possible, and a
        blocked joint is pushed with the torque limit of its motor. `tau` alone is within the limit.
        A false velocity in one LowState must not become a target velocity.
        """
        state = self._state
        state[0], state[1] = measured.q, measured.steady_dq
        state[0] += age * state[1]
        shares = gains * (asked - state)
        torque = shares[0] + shares[1] + tau
        if not np.count_nonzero(np.abs(torque) > self._effort):
            return asked
        excess = torque - np.clip(torque, -self._effort, self._effort)
        self.torque_limited += excess != 0.0
        eased: Floats = asked.copy()
        for row in (0, 1):
            less = np.clip(shares[row], np.minimum(excess, 0.0), np.maximum(excess, 0.0))
            excess = excess - less
            eased[row] -= np.divide(less, gains[row], out=np.zeros(N_JOINTS), where=less != 0.0)
        # A robot beyond a position limit must not move a target beyond it.
        lower, upper = np.minimum(asked[0], self._lower), np.maximum(asked[0], self._upper)
        eased[0] = np.clip(eased[0], lower, upper)
        # A joint faster than its velocity limit must not set a target velocity above the limit.
        eased[1] = np.clip(eased[1], -self._fastest, self._fastest)
        return eased
