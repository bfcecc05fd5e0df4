"""Checks of LowState: reasons not to begin a session, or to end it. Pure.

The checks run in this order: whether the LowState is plausible (here), what the operator requests
with the remote (`dds.remote`), whether it is the right robot (here), and the condition of the robot
(`monitor`). docs/safety.md explains every threshold.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.monitor import RobotMonitor
from g1stream.control.reading import Reading, all_finite, is_unit, ticks_between
from g1stream.control.stop import Stop
from g1stream.dds.remote import Operator
from g1stream.robot.joints import N_JOINTS, JointSet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.config import SafetyConfig
    from g1stream.dds.messages import LowState
    from g1stream.profiles import ProfileConstants
    from g1stream.robot.model import G1
    from g1stream.types import Floats

__all__ = ["LONGEST_INTERVAL", "LowStateChecks", "state_timeout"]

LONGEST_INTERVAL: Final = 0.1
"""Maximum interval of LowStates at which a robot may be commanded, s."""

_SELDOM: Final = f"LowState arrives less often than every {LONGEST_INTERVAL:g} s"
#: Maximum distance of a joint beyond its limits at the start of RAMP, rad: the play of an end stop.
_START_TOLERANCE: Final = 0.1
#: Factor by which a joint that something hits may be faster than its motor.
_HIT: Final = 2.0
#: Time over which wrong CRCs are counted, ns.
_CRC_WINDOW: Final = 1_000_000_000


def state_timeout(config: SafetyConfig) -> tuple[float, str]:
    """The maximum age of the last LowState, s, and the name of this limit for messages."""
    limit = config.state_timeout
    return limit, f"limit safety.state_timeout = {limit:g} s"


class LowStateChecks:
    """Checks LowStates as they arrive, for reasons to wait or to end the session.

    CRC and tick are optional, and are detected from the messages. A CRC that is not 0 must be
    right, and after a right CRC, 0 is wrong as well. A tick that has advanced must keep advancing.

    Args:
        robot: the robot with its limits.
        held: (29,) joints with a position servo.
        config, constants: the thresholds.
        period: time between two checks of LowState, ns.
        wait_for: as `stream.wait_for`.

    Attributes:
        measured: the newest LowState with a right CRC; None before the first.
        crc_errors: number of LowStates that were dropped because of their CRC.
        missing: why the first command has to wait, for the operator or for more LowStates, or "".
        stop: why the session must end because of the newest LowState, or None; see `unknown` for a
            LowState that is not plausible.
        go_on: the button of `wait_for` is pressed, and was not in the LowState before.

    Raises:
        ConfigError: a setting is not a button of the remote.
    """

    def __init__(
        self,
        robot: G1,
        held: NDArray[np.bool_],
        config: SafetyConfig,
        constants: ProfileConstants,
        period: int = 0,
        wait_for: str | None = None,
    ) -> None:
        self.go_on = False
        self.measured: Reading | None = None
        self.crc_errors = 0
        self.missing = ""
        self.stop: Stop | None = None
        self._monitor = RobotMonitor(robot, held, config, constants, period)
        self._operator = Operator(config.stop_buttons, config.deadman, wait_for)
        self._config, self._constants = config, constants
        self._robot = robot
        self._allowed = robot.joint_set.allowed(config.mode_machine)
        self._timeout, self._timeout_words = state_timeout(config)
        self._set_tolerance(min(_START_TOLERANCE, constants.limit_excess))
        self._wrong_crcs: deque[int] = deque(maxlen=constants.max_crc_errors + 1)
        self._begun = False
        self._publisher: int | None = None
        self._forget_publisher()

    def _forget_publisher(self) -> None:
        """Forget which optional fields the publisher provides."""
        self.measured = None
        self._interval = math.inf  # between the newest two LowStates, s
        self._has_crc = self._ticks = False
        self._tick: int | None = None
        self._tick_since = self._content_since = self._content_tick = 0
        self._content_target: Floats | None = None
        self._fault = self._other_robot = ""

    def _set_tolerance(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self._lower = (self._robot.lower - tolerance).astype(np.float32)
        self._upper = (self._robot.upper + tolerance).astype(np.float32)

    def begin(self, support: str | None) -> None:
        """Begin with commands; from now on it must be the same robot.

        The targets begin at the measured pose, and the robot must move with them.

        Args:
            support: how the robot is held; None: not known.
        """
        self._begun = True
        self._monitor.max_tilt = self._config.tilt_limit(support)
        if self.measured:
            self._content_since = self.measured.arrived
            self._content_target = self.measured.q.astype(np.float64)
        self._set_tolerance(self._constants.limit_excess)

    def need_not_follow(self) -> None:
        """From now on the joints need not follow the motion, because a policy moves them."""
        self._monitor.follow = np.zeros(N_JOINTS, np.bool_)

    def take(
        self, state: LowState, publisher: int, now: int, target: Floats | None = None
    ) -> Reading | None:
        """Check a LowState; return its reading, or None if it is dropped.

        Args:
            state: the LowState.
            publisher: identity of its publisher.
            now: time of reception, ns of the monotonic clock.
            target: (29,) rad, the current joint targets; None before the first command.
        """
        measured = self._read(state, publisher, now, target)
        if measured is None:
            return None
        buttons = state.buttons
        self.go_on = self._operator.goes_on(buttons)
        seldom = _SELDOM if self._interval > LONGEST_INTERVAL else ""
        self.missing = self._operator.missing(buttons) or seldom
        if self.unknown(now, target):
            self.stop = None
        elif self._begun and (pressed := self._operator.stop_reason(buttons)):
            self.stop = Stop("operator", pressed)
        elif wrong := self._wrong_robot() or self._wrong_mode(state):
            self.stop = Stop("robot", wrong)
        else:
            self.stop = self._monitor.stop(state, measured, now, target)
        return measured

    def _read(
        self, state: LowState, publisher: int, now: int, target: Floats | None
    ) -> Reading | None:
        """Copy a LowState, and check whether it is plausible; None if its CRC is wrong."""
        if publisher != self._publisher:
            if self._begun:
                self._other_robot = (
                    "the publisher of LowState has changed since RAMP began: the robot or "
                    "simulator was restarted, or there are two"
                )
            else:
                self._forget_publisher()
            self._publisher = publisher
        if not self._crc_is_right(state):
            self.crc_errors += 1
            self._wrong_crcs.append(now)
            return None
        before = self.measured
        measured = Reading.from_low_state(state, now, before)
        self._interval = (now - before.arrived) / 1e9 if before else math.inf
        self._check_tick(int(state.tick), now)
        if before is None or measured.content != before.content:
            self._fault = self._implausible(measured)
            if self._begun and before and not self._fault:
                self._fault = self._impossible(before, measured, int(state.tick))
            self._content_since, self._content_target = now, target
            self._content_tick = int(state.tick)
        if self._begun and before and measured.mode_machine != before.mode_machine:
            self._other_robot = self._other_robot or (
                f"mode_machine changed from {before.mode_machine} to {measured.mode_machine}: "
                "this is another robot"
            )
        self.measured = measured
        return measured

    def unknown(self, now: int, target: Floats | None = None) -> str:
        """Why the state of the robot is unknown, or "".

        Before the first command, the session waits, because the first LowStates of a simulator may
        be all zeros. Afterwards the session ends.

        Args:
            now: time, ns of the same clock as for `take`.
            target: (29,) rad, the current joint targets; None before the first command.
        """
        dropped = f"; {self.crc_errors} with a wrong CRC were dropped" if self.crc_errors else ""
        if self.measured is None:
            return f"no LowState received{dropped}"
        age = (now - self.measured.arrived) / 1e9
        if age > self._timeout:
            return f"no LowState for {age:.3f} s ({self._timeout_words}){dropped}"
        return (
            self._other_robot or self._fault or self._crcs_wrong(now) or self._frozen(now, target)
        )

    def _wrong_robot(self) -> str:
        """Why this kind of robot may not be commanded, or ""."""
        if self.measured is None or (mode := self.measured.mode_machine) in self._allowed:
            return ""
        theirs = JointSet.of_mode(mode)
        return (
            f"the robot has mode_machine {mode}"
            + (f" ({theirs}: --robot {theirs.name})" if theirs else "")
            + f"; {', '.join(map(str, self._allowed))} may be commanded as {self._robot.joint_set}"
        )

    def _wrong_mode(self, state: LowState) -> str:
        """Why the joints of this LowState are not those of a LowCmd, or ""."""
        if not (mode := int(state.mode_pr)):
            return ""
        return (
            f"the robot has mode_pr {mode}: its ankles and waist are motors A and B instead of "
            "pitch and roll; only 0 is played, so end the program that has set it"
        )

    def _crc_is_right(self, state: LowState) -> bool:
        if not self._has_crc and not int(state.crc):
            return True  # not provided
        right = state.crc_matches()
        self._has_crc = self._has_crc or right
        return right

    def _crcs_wrong(self, now: int) -> str:
        most = self._constants.max_crc_errors
        wrong = self._wrong_crcs
        if len(wrong) <= most or now - wrong[0] > _CRC_WINDOW:
            return ""
        return f"more than {most} LowStates within a second had a wrong CRC"

    def _check_tick(self, tick: int, now: int) -> None:
        if tick == self._tick:
            return
        if self._tick is not None:
            self._ticks = True
            if self._begun and ticks_between(self._tick, tick) < 0:
                self._other_robot = self._other_robot or (
                    f"the tick of LowState went back from {self._tick} to {tick}: its publisher "
                    "was restarted"
                )
        self._tick, self._tick_since = tick, now

    def _implausible(self, measured: Reading) -> str:
        """Why a reading is impossible for this robot, or ""."""
        if not measured.finite:
            return f"LowState contains a {self._not_finite(measured)} that is NaN or infinite"
        if not is_unit(quat := measured.imu.quat_wxyz):
            return f"the IMU quaternion has norm {math.hypot(*quat.tolist()):.3f}"
        q = measured.q
        if ((q < self._lower) | (q > self._upper)).any():
            joint = int(np.argmax(np.maximum(self._lower - q, q - self._upper)))
            low, high = self._robot.lower[joint], self._robot.upper[joint]
            return (
                f"{self._robot.joint_names[joint]} is at {q[joint]:.3f} rad, beyond its limits "
                f"{low:.3f} and {high:.3f} by more than {self._tolerance:g} rad"
            )
        return ""

    def _not_finite(self, measured: Reading) -> str:
        """The name of the first value that is not finite, with its joint."""
        joints = {"position": measured.q, "velocity": measured.dq, "torque": measured.tau}
        for what, values in joints.items():
            if not all_finite(values):
                return f"{what} of {self._robot.joint_names[int(np.argmin(np.isfinite(values)))]}"
        imu = zip(("quaternion", "gyroscope", "accelerometer"), measured.imu, strict=True)
        return "reading of the " + ", ".join(name for name, one in imu if not all_finite(one))

    def _impossible(self, before: Reading, measured: Reading, tick: int) -> str:
        """Why a joint cannot have moved like this since the last change of content, or ""."""
        step, speed = np.abs(measured.q - before.q), np.abs(measured.dq)
        fastest, most = self._robot.velocity, self._constants.max_leap
        if step.max() <= most and (speed <= fastest).all():  # nearly always
            return ""
        # A simulator that is late catches up in a burst; its ticks, in ms, give the passed time.
        ticks = ticks_between(self._content_tick, tick)
        passed = max((measured.arrived - self._content_since) / 1e9, ticks / 1e3)
        allowed = fastest * passed + most
        if (step > allowed).any():
            joint = int(np.argmax(step - allowed))
            return (
                f"{self._robot.joint_names[joint]} jumped by {step[joint]:.3f} rad in "
                f"{passed:.3f} s, {fastest[joint]:g} rad/s allow {allowed[joint]:.3f} "
                f"with a tolerance of {most:g} rad"
            )
        # A joint may reverse within a step, and an impact makes it faster than its motor.
        unseen = speed - _HIT * fastest
        if (unseen * passed > step).any():
            joint = int(np.argmax(unseen * passed - step))
            return (
                f"{self._robot.joint_names[joint]} reports {speed[joint]:.1f} rad/s, but moved by "
                f"{step[joint]:.3f} rad in {passed:.3f} s (its limit is {fastest[joint]:g} rad/s)"
            )
        return ""

    def _frozen(self, now: int, target: Floats | None) -> str:
        limit, moved_limit = self._constants.frozen_timeout, self._constants.frozen_motion
        still = (now - self._tick_since) / 1e9
        words = f"limit {limit:g} s"
        if self._ticks and still > limit:
            return f"the tick of LowState has been {self._tick} for {still:.3f} s ({words})"
        still = (now - self._content_since) / 1e9
        if still <= limit:
            return ""
        # The targets begin at the measured pose where RAMP begins.
        start, moved = self._content_target, 0.0
        if start is not None and target is not None:
            moved = float(np.abs(target - start).max())
        if moved < moved_limit or (target is None and moved_limit > 0.0):
            return ""
        return (
            f"LowState has not changed for {still:.3f} s while the targets moved by "
            f"{moved:.3f} rad ({words}, while they move by {moved_limit:g} rad)"
        )
