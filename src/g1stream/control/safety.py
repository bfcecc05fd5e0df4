"""What is measured of the robot, the limits of a command, and the checks that end a session; pure.

docs/safety.md explains every threshold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.errors import ConfigError, SafetyError
from g1stream.motion.limits import POSITION_TOLERANCE
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.config import SafetyConfig
    from g1stream.robot.model import G1

__all__ = [
    "STATE_TIMEOUT",
    "Envelope",
    "ImuReading",
    "Measured",
    "all_finite",
    "is_unit",
    "tilt_of",
]

STATE_TIMEOUT: Final = 0.1
"""Age of the last LowState that stops, s, where `safety.state_timeout` is unset: of a robot."""

#: Allowed deviation of the norm of the IMU's quaternion from 1.
_LENGTH_TOLERANCE: Final = 0.05


@dataclass
class Measured:
    """The newest LowState, as far as safety checks need it.

    Attributes:
        q, dq: (29,) rad, rad/s, motor order.
        quat_wxyz: (4,) pelvis to world.
        mode_machine: robot type.
        received: time of reception, ns of the loop's monotonic clock.
    """

    q: NDArray[np.float32]
    dq: NDArray[np.float32]
    quat_wxyz: NDArray[np.float32]
    mode_machine: int
    received: int


def tilt_of(quat_wxyz: NDArray[np.floating]) -> float:
    """The angle between the body's z axis and the world's, rad, of a unit quaternion (4,) wxyz.

    The world's z component of the rotated z axis is 1 - 2 (x^2 + y^2).
    """
    x, y = float(quat_wxyz[1]), float(quat_wxyz[2])
    return math.acos(min(1.0, max(-1.0, 1.0 - 2.0 * (x * x + y * y))))


class ImuReading(NamedTuple):
    """A reading of the IMU in the pelvis.

    Attributes:
        quat_wxyz: (4,) pelvis to world.
        gyroscope: (3,) rad/s, pelvis frame.
        accelerometer: (3,) m/s², pelvis frame, gravity included: upward 9.81 at rest.
    """

    quat_wxyz: NDArray[np.floating]
    gyroscope: NDArray[np.floating]
    accelerometer: NDArray[np.floating]


def all_finite(values: NDArray[np.floating]) -> bool:
    """Whether no number of a short array is NaN or infinite: either one makes the sum so."""
    return math.isfinite(sum(values.tolist()))


def is_unit(quat_wxyz: NDArray[np.floating]) -> bool:
    """Whether a measured quaternion (4,) has a norm close to 1; False if it contains NaN."""
    return abs(math.hypot(*quat_wxyz.tolist()) - 1.0) < _LENGTH_TOLERANCE


class Envelope:
    """Clamps commands to the joint limits and checks measurements against the safety settings.

    Attributes:
        clamped: (29,) int64, ticks at which each joint's target was clamped; as in
            `measure_limits`, not those that exceed a limit by less than `POSITION_TOLERANCE`.

    Raises:
        ConfigError: the margin leaves no range for a joint.
    """

    def __init__(self, robot: G1, config: SafetyConfig) -> None:
        self._config = config
        self._state_timeout = config.state_timeout or STATE_TIMEOUT
        self._lower = robot.lower + config.position_margin
        self._upper = robot.upper - config.position_margin
        self._begun: Floats = (robot.lower + robot.upper) / 2
        self._names = robot.joint_names
        narrowest = int(np.argmin(robot.upper - robot.lower))
        if self._lower[narrowest] > self._upper[narrowest]:
            raise ConfigError(
                f"safety.position_margin = {config.position_margin:g} rad leaves no range for "
                f"{self._names[narrowest]}, whose limits are {robot.lower[narrowest]:g} and "
                f"{robot.upper[narrowest]:g} rad.",
                "Set a margin below half of that range.",
            )
        self.clamped: Ints = np.zeros(len(robot.joint_names), dtype=np.int64)

    def begin(self, q: NDArray[np.floating]) -> None:
        """Set the measured pose (29,) from which RAMP starts, rad; it may violate the limits."""
        self._begun = np.asarray(q, dtype=np.float64).copy()

    def limit(self, q: Floats, ramped: float = 1.0) -> Floats:
        """Joint targets (29,) clamped to the limits, rad; `q` itself if none is clamped.

        For a joint that starts RAMP outside a limit, the limit moves from the start pose to its
        final value with the ramp, so that the command has no step.

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
            excess: how far each target was above its upper limit, or below its lower one
                (negative), rad.
            dq: target velocities, rad/s.
            tau: feed-forward torques, N·m.

        Returns:
            dq, zero for clamped joints, and tau, zero for clamped joints that it pushes outward.
        """
        return np.where(excess, 0.0, dq), np.where(excess * tau > 0.0, 0.0, tau)

    def require_finite(self, **targets: NDArray[np.floating]) -> None:
        """Refuse targets (29,) that contain NaN or infinity.

        Raises:
            SafetyError: names the first such joint.
        """
        for what, values in targets.items():
            if not all_finite(values):
                joint = int(np.argmin(np.isfinite(values)))
                raise SafetyError(
                    f"The command for {self._names[joint]} has {what} = {values[joint]}.",
                    "Check the motion with `g1stream motion`, and the URDF.",
                )

    def stalled(self, gap: int) -> str:
        """Why the session must end after a gap of `gap` ns between two ticks, or ""."""
        limit = self._state_timeout
        if gap / 1e9 <= limit:
            return ""
        return f"the loop stalled for {gap / 1e9:.3f} s on this machine ({self._limit})"

    def implausible(self, now: int, state: Measured) -> str:
        """Why nothing is known of the robot now, or "".

        Before the first command that is waited out, because the first LowStates of a simulator may
        be all zeros; afterwards it ends the session.

        Args:
            now: ns, same clock as `state.received`.
            state: the newest measurement.
        """
        age = (now - state.received) / 1e9
        if age > self._state_timeout:
            return f"no LowState for {age:.3f} s ({self._limit})"
        if not (all_finite(state.q) and all_finite(state.dq)):
            return "LowState contains a joint position or velocity that is NaN or infinite"
        if not is_unit(state.quat_wxyz):
            return f"the IMU quaternion has norm {math.hypot(*state.quat_wxyz.tolist()):.3f}"
        return ""

    def verdict(self, state: Measured) -> str:
        """Why the session must end with a plausible measurement, or ""."""
        return self._wrong_robot(state) or self._tilted(state) or self._too_fast(state)

    @property
    def _limit(self) -> str:
        return f"limit safety.state_timeout = {self._state_timeout:g} s"

    def _wrong_robot(self, state: Measured) -> str:
        allowed = self._config.mode_machine
        if state.mode_machine in allowed:
            return ""
        return (
            f"the robot has mode_machine {state.mode_machine} (allowed for 29 joints: "
            f"{', '.join(map(str, allowed))})"
        )

    def _tilted(self, state: Measured) -> str:
        tilt = tilt_of(state.quat_wxyz)
        if tilt <= self._config.max_tilt:
            return ""
        return f"the pelvis tilt is {tilt:.2f} rad (limit {self._config.max_tilt:g} rad)"

    def _too_fast(self, state: Measured) -> str:
        speeds = [abs(speed) for speed in state.dq.tolist()]
        speed = max(speeds)
        if speed <= self._config.max_joint_speed:
            return ""
        return (
            f"{self._names[speeds.index(speed)]} moves at {speed:.1f} rad/s "
            f"(limit {self._config.max_joint_speed:g} rad/s)"
        )
