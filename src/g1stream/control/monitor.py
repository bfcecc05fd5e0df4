"""Monitoring of the robot: attitude, speed, tracking, motors and temperatures. Pure.

docs/safety.md explains every threshold.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.stop import Stop
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.rotations import tilt_of
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.config import SafetyConfig
    from g1stream.control.reading import Reading
    from g1stream.dds.messages import LowState
    from g1stream.profiles import ProfileConstants
    from g1stream.robot.model import G1

__all__ = ["MOTOR_FAULTS", "RobotMonitor"]

#: Interval of the checks except attitude and speed, ns; the other values do not change faster.
_PERIOD: Final = 20_000_000
#: Maximum increment of the robot's time per measurement, ns: the longest step of the simulators.
_MAX_STEP: Final = 5_000_000
#: Interval of the checks for a jam, ns.
_JAM_PERIOD: Final = 100_000_000
#: Time below the voltage limit after which it is not a short dip, s.
_VOLTAGE_TIME: Final = 0.5
#: Pelvis tilt beyond which no session begins, rad: the robot is upside down, or its IMU is wrong.
_OVERTURNED: Final = 2.6
#: Share of its target's motion below which a joint counts as jammed.
_JAM_SHARE: Final = 0.1
_NEVER: Final = 1 << 62

MOTOR_FAULTS: Final = {
    0x1: "overcurrent",
    0x2: "transient overvoltage",
    0x4: "sustained overvoltage",
    0x8: "transient undervoltage",
    0x10: "chip overheating",
    0x20: "MOSFET overheating or undercooling",
    0x40: "MOSFET temperature anomaly",
    0x80: "casing overheating or undercooling",
    0x100: "casing temperature anomaly",
    0x200: "winding overheating",
    0x400: "rotor encoder 1 error",
    0x800: "rotor encoder 2 error",
    0x1000: "output encoder error",
    0x2000: "calibration or boot data error",
    0x4000: "abnormal reset",
    0x8000: "motor locked",
    0x10000: "chip verification error",
    0x20000: "calibration mode",
    0x40000: "communication error",
    0x80000: "driver version too low",
    0x40000000: "motor lost the connection to its controller",
    0x80000000: "controller lost the connection to the motor",
}
"""The bits of `motorstate`, from Unitree's list of G1 error codes."""


class _Lasting:
    """Measures for how long a condition of each joint has been true.

    Args:
        limit: maximum time, s.
    """

    def __init__(self, limit: float) -> None:
        self._limit = round(limit * 1e9)
        self._since: Ints = np.full(N_JOINTS, _NEVER, np.int64)

    def beyond(self, now: int, holds: NDArray[np.bool_]) -> int | None:
        """The joint whose condition has been true for longest, if above the limit, or None."""
        if not holds.any():
            self._since[:] = _NEVER
            return None
        self._since = np.where(holds, np.minimum(self._since, now), _NEVER)
        joint = int(np.argmin(self._since))
        return joint if now - self._since[joint] > self._limit else None


class RobotMonitor:
    """Monitors the robot with plausible LowStates.

    Durations are measured in the robot's time. A simulator without enough CPU time repeats its
    LowState and catches up later. The robot's time stops meanwhile, for at most
    `constants.frozen_timeout`.

    Args:
        robot: the robot with its limits.
        held: (29,) joints with a position servo, which follow a target.
        config, constants: the thresholds.
        period: time between two checks of LowState, ns.

    Attributes:
        max_tilt: pelvis tilt that ends the session, rad.
        follow: (29,) joints that must follow their targets; at first `held`.
    """

    def __init__(
        self,
        robot: G1,
        held: NDArray[np.bool_],
        config: SafetyConfig,
        constants: ProfileConstants,
        period: int = 0,
    ) -> None:
        self.max_tilt = _OVERTURNED if config.max_tilt is None else config.max_tilt
        self._config, self._constants = config, constants
        self._max_step = max(_MAX_STEP, period)
        self._patience = round(constants.frozen_timeout * 1e9)
        self._names, self._present = robot.joint_names, robot.present
        self.follow = held
        self._lower, self._upper = robot.lower, robot.upper
        self._torque = (robot.torque_limit * config.max_torque).astype(np.float32)
        self._faults = _Lasting(constants.motor_fault_time)
        self._off = _Lasting(constants.motor_fault_time)
        self._low_voltage = _Lasting(_VOLTAGE_TIME)
        self._high_torque = _Lasting(constants.torque_time)
        self._has_modes = False
        self._error: Floats = np.zeros(N_JOINTS)
        rows = max(2, round(constants.jam_time * 1e9 / _JAM_PERIOD) + 1)
        self._history = np.zeros((rows, 2, N_JOINTS))
        self._recorded = 0
        self._content = b""
        self._changed = self._seen = self._next = 0
        self._time = self._last = self._next_jam = 0  # in the robot's time

    def stop(
        self, state: LowState, measured: Reading, now: int, target: Floats | None = None
    ) -> Stop | None:
        """Why the session must end; None if it need not.

        Args:
            state: a LowState.
            measured: the reading of the same LowState.
            now: time, ns of the monotonic clock.
            target: (29,) rad, the current joint targets; None before the first command.
        """
        if measured.content != self._content:
            self._time += min(now - self._changed, self._max_step)
            self._content, self._changed = measured.content, now
        elif now - self._changed > self._patience:
            self._time += now - self._seen
        self._seen = now
        urgent = self._tilted(measured) or self._too_fast(measured)
        if urgent or now < self._next:
            return urgent
        self._next = now + _PERIOD
        found = self._too_hot(state) or self._without_voltage(state, now)
        if found or target is None:
            return found
        target = np.where(self.follow, np.clip(target, self._lower, self._upper), measured.q)
        time, passed = self._time, (self._time - self._last) / 1e9
        self._last = time
        return (
            self._motor_off(state, time)
            or self._motor_fault(state, time)
            or self._overloaded(measured, time)
            or self._off_track(measured, target, passed)
            or self._jammed(measured, target, time)
        )

    def _tilted(self, measured: Reading) -> Stop | None:
        tilt, limit = tilt_of(measured.imu.quat_wxyz), self.max_tilt
        if tilt <= limit:
            return None
        return Stop(
            "tilt",
            f"the pelvis tilt is {tilt:.2f} rad ({limit:g} rad is upside down, or its IMU is wrong)"
            if self._config.max_tilt is None and limit == _OVERTURNED
            else f"the pelvis tilt is {tilt:.2f} rad (limit safety.max_tilt = {limit:g} rad)",
        )

    def _too_fast(self, measured: Reading) -> Stop | None:
        limit, dq = self._config.max_joint_speed, measured.dq
        if max(dq.max(), -dq.min()) <= limit:
            return None
        joint = int(np.argmax(np.abs(dq)))
        return Stop(
            "speed",
            f"{self._names[joint]} moves at {abs(dq[joint]):.1f} rad/s "
            f"(limit safety.max_joint_speed = {limit:g} rad/s)",
        )

    def _too_hot(self, state: LowState) -> Stop | None:
        constants = self._constants
        hottest = state.temperature.max(axis=0)
        limits = (constants.max_casing_temperature, constants.max_winding_temperature)
        for i, (part, limit) in enumerate(zip(("casing", "winding"), limits, strict=True)):
            if hottest[i] > limit:
                joint = int(np.argmax(state.temperature[:, i]))
                return Stop(
                    "temperature",
                    f"the {part} of {self._names[joint]} has {hottest[i]} °C (limit {limit:g} °C)",
                )
        return None

    def _without_voltage(self, state: LowState, now: int) -> Stop | None:
        volts, limit = state.vol, self._constants.min_voltage
        joint = self._low_voltage.beyond(now, (volts < limit) & (volts > 0.0))
        if joint is None:
            return None
        text = f"{self._names[joint]} is supplied with {volts[joint]:.1f} V (limit {limit:g} V)"
        return Stop("voltage", text)

    def _motor_off(self, state: LowState, now: int) -> Stop | None:
        modes = np.where(self._present, state.motor_mode, 1 if self._has_modes else 0)
        self._has_modes = self._has_modes or bool(modes.any())
        if not self._has_modes:
            return None
        joint = self._off.beyond(now, modes == 0)
        if joint is None:
            return None
        return Stop(
            "motor",
            f"the motor of {self._names[joint]} is off (mode 0) although it is commanded on, one "
            f"of {np.count_nonzero(modes == 0)} "
            f"(limit {self._constants.motor_fault_time:g} s)",
        )

    def _motor_fault(self, state: LowState, now: int) -> Stop | None:
        bits = state.motorstate & np.uint32(self._config.motor_fault_mask) * self._present
        joint = self._faults.beyond(now, bits != 0)
        if joint is None:
            return None
        value = int(bits[joint])
        named = [text for bit, text in MOTOR_FAULTS.items() if value & bit]
        return Stop(
            "motor",
            f"the motor of {self._names[joint]} reports motorstate 0x{value:x}: "
            f"{', '.join(named) or 'unknown'} "
            f"(limit {self._constants.motor_fault_time:g} s, bits of safety.motor_fault_mask)",
        )

    def _overloaded(self, measured: Reading, now: int) -> Stop | None:
        torque = np.abs(measured.tau)
        joint = self._high_torque.beyond(now, torque > self._torque)
        if joint is None:
            return None
        config = self._config
        return Stop(
            "torque",
            f"{self._names[joint]} has {torque[joint]:.1f} N·m for more than "
            f"{self._constants.torque_time:g} s (limit {self._torque[joint]:.1f} N·m, "
            f"safety.max_torque = {config.max_torque:g} times its torque limit)",
        )

    def _off_track(self, measured: Reading, target: Floats, passed: float) -> Stop | None:
        average, limit = self._constants.tracking_time, self._config.max_tracking_error
        share = min(1.0, passed / average)
        self._error += (np.abs(target - measured.q) - self._error) * share
        joint = int(np.argmax(self._error))
        if self._error[joint] <= limit:
            return None
        return Stop(
            "tracking",
            f"{self._names[joint]} is {abs(target[joint] - measured.q[joint]):.2f} rad from its "
            f"target, {self._error[joint]:.2f} rad on average over {average:g} s "
            f"(limit safety.max_tracking_error = {limit:g} rad)",
        )

    def _jammed(self, measured: Reading, target: Floats, now: int) -> Stop | None:
        if now < self._next_jam:
            return None
        self._next_jam = now + _JAM_PERIOD
        rows = len(self._history)
        self._history[self._recorded % rows] = target, measured.q
        self._recorded += 1
        if self._recorded < rows:
            return None
        asked, moved = np.ptp(self._history, axis=0)
        jammed = (asked > self._constants.jam_motion) & (moved < _JAM_SHARE * asked)
        if not jammed.any():
            return None
        joint = int(np.argmax(np.where(jammed, asked, 0.0)))
        return Stop(
            "jam",
            f"{self._names[joint]} does not follow: its target moved by {asked[joint]:.2f} rad in "
            f"{self._constants.jam_time:g} s, the joint by {moved[joint]:.2f} rad with "
            f"{abs(measured.tau[joint]):.1f} N·m "
            f"(limit {_JAM_SHARE:.0%} of its target's motion)",
        )
