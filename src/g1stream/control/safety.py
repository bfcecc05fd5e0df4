"""The limits a command stays within and the measurements that end a session; pure.

docs/safety.md explains every threshold.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from g1stream.control.measured import all_finite, is_unit, tilt_of
from g1stream.errors import ConfigError, SafetyError
from g1stream.motion.limits import POSITION_TOLERANCE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.config import SafetyConfig
    from g1stream.control.measured import Measured
    from g1stream.robot.model import G1

__all__ = ["Envelope"]


class Envelope:
    """Keeps commands within the joint limits, and judges measurements.

    Attributes:
        clamped: (29,) int64, at how many ticks each joint's target was held at its limit. As in
            `measure_limits`, less than `POSITION_TOLERANCE` beyond it is held too, but not counted.

    Raises:
        ConfigError: the margin leaves nothing of a joint's range.
    """

    def __init__(self, robot: G1, config: SafetyConfig) -> None:
        self._config = config
        self._lower = robot.lower + config.position_margin
        self._upper = robot.upper - config.position_margin
        self._begun: NDArray[np.float64] = (robot.lower + robot.upper) / 2
        self._names = robot.joint_names
        narrowest = int(np.argmin(robot.upper - robot.lower))
        if self._lower[narrowest] > self._upper[narrowest]:
            raise ConfigError(
                f"The setting safety.position_margin = {config.position_margin:g} leaves nothing "
                f"of the range of {self._names[narrowest]}, {robot.lower[narrowest]:g} to "
                f"{robot.upper[narrowest]:g} rad.",
                "Choose less than half of that range.",
            )
        self.clamped: NDArray[np.int64] = np.zeros(len(robot.joint_names), dtype=np.int64)

    def begin(self, q: NDArray[np.floating]) -> None:
        """Set the measured pose (29,) that a ramp starts from, rad; it may be beyond the limits."""
        self._begun = np.asarray(q, dtype=np.float64).copy()

    def limit(self, q: NDArray[np.float64], ramped: float = 1.0) -> NDArray[np.float64]:
        """Joint targets (29,) within the limits, rad; `q` itself where they are.

        A joint that was beyond a limit where the ramp began is brought inside with it, at no tick
        by a leap.

        Args:
            q: the targets, rad.
            ramped: how much of the ramp's way lies behind, 0 to 1.
        """
        lower, upper = self._lower, self._upper
        if ramped < 1.0:
            begun = self._begun
            lower = np.minimum(lower, begun + ramped * (lower - begun))
            upper = np.maximum(upper, begun + ramped * (upper - begun))
        limited: NDArray[np.float64] = np.minimum(np.maximum(q, lower), upper)
        if not np.count_nonzero(limited != q):
            return q
        self.clamped += np.abs(limited - q) > POSITION_TOLERANCE
        return limited

    @staticmethod
    def inward(
        beyond: NDArray[np.float64], dq: NDArray[np.float64], tau: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Velocities and torques (29,) that drive no joint into the limit it is held at.

        Args:
            beyond: by how much each target lay above its limit, or below it (negative), rad.
            dq: the velocities asked for, rad/s.
            tau: the torques asked for, N·m.

        Returns:
            dq, zero where a target is held, and tau, zero where it would push outward there.
        """
        return np.where(beyond, 0.0, dq), np.where(beyond * tau > 0.0, 0.0, tau)

    def require_finite(self, **targets: NDArray[np.floating]) -> None:
        """Refuse targets (29,) that hold a number that is not finite.

        Raises:
            SafetyError: names the first joint of which one does.
        """
        for what, values in targets.items():
            if not all_finite(values):
                joint = int(np.argmin(np.isfinite(values)))
                raise SafetyError(
                    f"The motion asks for {what} = {values[joint]} of {self._names[joint]}.",
                    "Command finite numbers only; `g1stream motion` shows what a motion asks for.",
                )

    def stalled(self, gap: int) -> str:
        """Why the session must end after `gap` ns in which the loop stood still, or ""."""
        if gap / 1e9 <= self._config.state_timeout:
            return ""
        return (
            f"the loop stood still for {gap / 1e9:.3f} s (limit {self._config.state_timeout:g} s)"
        )

    def verdict(self, now: int, state: Measured) -> str:
        """Why the session must end, or "" while all is well.

        Args:
            now: ns of the clock that `state.received` is of.
            state: the latest measurement.
        """
        age = (now - state.received) / 1e9
        if age > self._config.state_timeout:
            return f"no LowState for {age:.3f} s (limit {self._config.state_timeout:g} s)"
        if not (all_finite(state.q) and all_finite(state.dq)):
            return "LowState holds a number that is not finite"
        return self._wrong_robot(state) or self._tilted(state) or self._too_fast(state)

    def _wrong_robot(self, state: Measured) -> str:
        allowed = self._config.mode_machine
        if state.mode_machine in allowed:
            return ""
        return (
            f"the robot says mode_machine {state.mode_machine}, and only "
            f"{', '.join(map(str, allowed))} may be commanded with 29 joints"
        )

    def _tilted(self, state: Measured) -> str:
        if not is_unit(state.quat_wxyz):
            return f"the IMU's quaternion has the norm {math.hypot(*state.quat_wxyz.tolist()):.3f}"
        tilt = tilt_of(state.quat_wxyz)
        if tilt <= self._config.max_tilt:
            return ""
        return f"the pelvis is tilted by {tilt:.2f} rad (limit {self._config.max_tilt:g} rad)"

    def _too_fast(self, state: Measured) -> str:
        speeds = [abs(speed) for speed in state.dq.tolist()]
        speed = max(speeds)
        if speed <= self._config.max_joint_speed:
            return ""
        return (
            f"{self._names[speeds.index(speed)]} moves at {speed:.1f} rad/s "
            f"(limit {self._config.max_joint_speed:g} rad/s)"
        )
