"""The real-time loop: one thread, absolute deadlines, nothing that can block.

At each deadline it writes what was prepared for it, then takes the newest LowState and prepares the
next command, so that only a write lies between the deadline and the wire.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Final

from g1stream.clock import Ticker
from g1stream.control.feedforward import FeedForward
from g1stream.control.gains import resolve_gains
from g1stream.control.phases import Inputs, PhaseState, Timing, step
from g1stream.control.report import LoopReport
from g1stream.control.safety import Envelope, ImuReading, Measured
from g1stream.control.targets import Targets
from g1stream.dds.messages import LowCmd, LowState, Reference
from g1stream.dds.topics import LOWCMD
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.correction import Conditions, CorrectionSpline
from g1stream.motion.limits import Interval
from g1stream.types import Phase

if TYPE_CHECKING:
    from g1stream.clock import Clock
    from g1stream.config import Config, StreamConfig
    from g1stream.control.gains import Gains
    from g1stream.control.link import Link
    from g1stream.control.targets import Target
    from g1stream.motion.correction import Correction
    from g1stream.motion.trajectory import Trajectory
    from g1stream.robot.model import G1

__all__ = ["Composer", "LoopReport", "StreamLoop", "make_loop"]

_LOGGER = logging.getLogger(__name__)

#: How long other publishers of LowCmd are waited for before the first command, ns.
_SETTLE: Final = 100_000_000
#: How often the loop looks for other publishers afterwards, ns.
_PUBLISHER_CHECK_PERIOD: Final = 100_000_000
#: How often it reports skipped ticks, ns.
_OVERRUN_REPORT_PERIOD: Final = 1_000_000_000
#: A servo holds its last target for that long without harm, ns; a longer overrun is a warning.
_LONG_OVERRUN: Final = 20_000_000
#: Longer than any session, ns.
_FOREVER: Final = 1 << 62


class Composer:
    """Makes the LowCmd and the Reference of a tick.

    Args:
        envelope: the limits of a command.
        gains: kp and kd in every phase but DAMP.
        damp_kd: kd in DAMP, Nm s/rad.
    """

    def __init__(self, envelope: Envelope, gains: Gains, damp_kd: float) -> None:
        self._envelope = envelope
        self._gains = gains
        self._damp_kd = damp_kd
        self._command, self._reference = LowCmd(), Reference()

    def begin(self, measured: Measured) -> None:
        """Enable the motors of the measured robot, with the gains of the motion."""
        self._envelope.begin(measured.q)
        command = self._command
        command.motor_mode = 1
        command.mode_pr[()] = 0  # the other mode changes the meaning of ankle and waist joints
        command.mode_machine[()] = measured.mode_machine
        command.kp[:], command.kd[:] = self._gains

    def damp(self) -> None:
        """Set the gains of DAMP: kp 0."""
        self._command.kp[:] = 0.0
        self._command.kd[:] = self._damp_kd

    def compose(
        self, due: Target, commanded: Target, phase: Phase, tick: int, ramped: float
    ) -> tuple[bytes, bytes]:
        """A sealed LowCmd and its Reference, as they go onto the wire.

        Args:
            due: the target at their publish time; published as Reference.
            commanded: the target of the LowCmd, which takes effect later; its torque is published
                in the Reference too.
            phase: of the session.
            tick: number of the Reference.
            ramped: progress of the ramp, 0 to 1.

        Raises:
            SafetyError: a value of the command is not finite.
        """
        command, reference, envelope = self._command, self._reference, self._envelope
        q, dq, tau = commanded.q, commanded.dq, commanded.tau
        limited = envelope.limit(q, ramped)
        if limited is not q:
            dq, tau = envelope.keep_inward(q - limited, dq, tau)
        command.q[:], command.dq[:], command.tau[:] = limited, dq, tau
        envelope.require_finite(q=command.q, dq=command.dq, tau=command.tau)
        reference.tick[()] = tick
        reference.phase[()] = phase
        reference.motion_time[()] = due.motion_time
        reference.target[:] = due.published
        reference.tau[:] = commanded.tau
        return command.seal(), reference.tobytes()


class StreamLoop:
    """Plays targets over a link until the motion ends or something stops it.

    Phase changes, overruns and reasons to stop are logged; the logger must not block, see
    `g1stream.events.handled_by`.

    Args:
        link: the wire.
        clock: now, stamp and sleep_until.
        targets: the target of each phase.
        envelope: limits and safety checks.
        timing: length of each phase.
        gains: kp and kd in every phase but DAMP.
        period: ns between commands.
        damp_kd: kd in DAMP, Nm s/rad.
        allow_second_writer: play although there is another publisher of LowCmd.
        feedforward: what a command carries beside the position; the velocity alone if left out.
        correction: added to the joint targets of the commands, not to the published reference;
            needs a feed-forward.

    Attributes:
        state: the current phase.
        motion_time: where in the motion the loop is, s.
        report: counts and timing so far, and in the end of the whole run.
    """

    def __init__(
        self,
        link: Link,
        clock: Clock,
        targets: Targets,
        envelope: Envelope,
        timing: Timing,
        gains: Gains,
        *,
        period: int,
        damp_kd: float,
        allow_second_writer: bool = False,
        feedforward: FeedForward | None = None,
        correction: CorrectionSpline | None = None,
    ) -> None:
        self._link = link
        self._clock = clock
        self._targets = targets
        self._envelope = envelope
        self._timing = timing
        self._undamped = replace(timing, hold=_FOREVER)
        self._composer = Composer(envelope, gains, damp_kd)
        self._period = period
        self._allow_second_writer = allow_second_writer
        self._feedforward = feedforward
        self._correction = correction
        self._low_state = state = LowState()
        self._imu = ImuReading(state.quaternion, state.gyroscope, state.accelerometer)
        self._measured: Measured | None = None
        self._skipped_when_measured = 0
        self._target: Target | None = None
        self._prepared: tuple[bytes, bytes] | None = None
        self._prepared_for = 0
        self._stop_reason = ""
        self._next_publisher_check = 0
        self._skipped_reported = self._next_overrun_report = self._longest_overrun = 0
        self.state = PhaseState(Phase.WAIT, 0)
        self.motion_time = 0.0
        self.report = LoopReport(period, envelope.clamped)

    def request_stop(self, reason: str) -> None:
        """End the run through DAMP; may be called from a signal handler or another thread."""
        self._stop_reason = self._stop_reason or reason

    def run(self) -> LoopReport:
        """Play until DONE.

        On any error after the first command, the robot is damped before the error is raised.
        """
        try:
            self._play()
        except BaseException as error:
            self._abort(error)
            raise
        finally:
            self.report.reason = self.state.reason
            if self._feedforward:
                self.report.robot = self._feedforward.robot
                self.report.time_scale = self._feedforward.median_time_scale
        return self.report

    def _play(self) -> None:
        self._link.receive(self._low_state)  # discarded: it may be from before this run
        start = self._clock.now()
        self.state = PhaseState(Phase.WAIT, start)
        ticker = Ticker(self._clock, self._period, start)
        skipped_waiting = 0
        for _, deadline in ticker:
            if self.state.phase is Phase.WAIT:
                skipped_waiting = ticker.skipped
            self.report.skipped = ticker.skipped - skipped_waiting
            self._tick(deadline)
            self._log_overruns(deadline)
            if self.state.phase is Phase.DONE:
                break

    def _tick(self, deadline: int) -> None:
        if self._prepared is not None:
            if self._prepared_for != deadline:
                self._catch_up(deadline)
            self._publish(deadline)
        begun = self._clock.now()
        self._receive(begun)
        self._advance(begun, deadline + self._period)
        if Phase.WAIT < self.state.phase < Phase.DONE:
            self._prepare(deadline + self._period)
        if self.report.commands:
            self.report.worst_work = max(self.report.worst_work, self._clock.now() - begun)

    def _log_overruns(self, deadline: int) -> None:
        """Report skipped ticks immediately, then at most once a second."""
        new = self.report.skipped - self._skipped_reported
        if not new or (deadline < self._next_overrun_report and self.state.phase is not Phase.DONE):
            return
        self._skipped_reported = self.report.skipped
        self._next_overrun_report = deadline + _OVERRUN_REPORT_PERIOD
        level = logging.WARNING if self._longest_overrun >= _LONG_OVERRUN else logging.INFO
        self._longest_overrun = 0
        _LOGGER.log(level, "overrun: ticks skipped: %d, %d in total", new, self.report.skipped)

    def _catch_up(self, deadline: int) -> None:
        """After skipped ticks: continue on time, or stop if the target has moved too far."""
        gap = deadline - self._prepared_for
        self._longest_overrun = max(self._longest_overrun, gap)
        if self.state.phase is Phase.DAMP:
            # The length of DAMP counts commands, not time without any.
            self.state = replace(self.state, since=self.state.since + gap)
        else:
            self.request_stop(self._envelope.stalled(gap))
            now = self._clock.now()
            self._receive(now)  # states that arrived meanwhile, before their age is checked
            self._advance(now, deadline)
        self._prepare(deadline)

    def _publish(self, deadline: int) -> None:
        if self._prepared is None:
            return
        command, reference = self._prepared
        stamp = self._clock.stamp()
        report = self.report
        report.lateness.add(self._link.send(command, reference, stamp) - deadline)
        report.commands += 1
        report.first_stamp = report.first_stamp or stamp
        report.last_stamp = stamp

    def _receive(self, now: int) -> None:
        state = self._low_state
        if not self._link.receive(state):
            return
        self.report.states += 1
        self._skipped_when_measured = self.report.skipped
        self._measured = Measured(state.q, state.dq, state.quaternion, int(state.mode_machine), now)
        if self._feedforward:
            self._feedforward.observe(now / 1e9, state.q, state.dq, state.tau_est, self._imu)

    def _advance(self, now: int, deadline: int) -> None:
        before = self.state
        unknown = self._robot_unknown(now)
        missing = unknown or self._no_subscriber() if before.phase is Phase.WAIT else ""
        inputs = Inputs(missing, self._reason_to_stop(now, unknown))
        self.state = step(deadline, before, inputs, self._timing)
        if self.state.phase is not before.phase:
            self._enter_phase(before.phase)

    def _no_subscriber(self) -> str:
        return "" if self._link.subscribers() else f"no subscriber on {LOWCMD.name}"

    def _robot_unknown(self, now: int) -> str:
        """Why nothing is known of the robot now, or "" where it is."""
        if self._measured is None:
            return "no LowState received"
        fault = self._envelope.implausible(now, self._measured)
        skipped = self.report.skipped - self._skipped_when_measured
        if fault and skipped:
            fault += f"; this machine stalled: the loop skipped {skipped} ticks meanwhile"
        return fault

    def _reason_to_stop(self, now: int, unknown: str) -> str:
        phase = self.state.phase
        if self._stop_reason or phase >= Phase.DAMP:
            return self._stop_reason
        if unknown and phase is not Phase.WAIT:
            return unknown
        wrong = self._envelope.verdict(self._measured) if self._measured and not unknown else ""
        return wrong or self._other_publisher(now)

    def _other_publisher(self, now: int) -> str:
        if self._allow_second_writer or now < self._next_publisher_check:
            return ""
        if self.state.phase is not Phase.WAIT:  # while waiting, every tick
            self._next_publisher_check = now + _PUBLISHER_CHECK_PERIOD
        others = self._link.other_publishers()
        return f"another publisher on {LOWCMD.name}: {', '.join(others)}" if others else ""

    def _enter_phase(self, before: Phase) -> None:
        phase, measured = self.state.phase, self._measured
        if phase is Phase.RAMP and measured is not None:
            self._targets.begin(measured.q)
            self._composer.begin(measured)
            self._begin_feedforward()
        elif phase is Phase.DAMP:
            self._composer.damp()
        if self.state.reason and before < Phase.DAMP:
            _LOGGER.error("%s -> %s: %s", before.name, phase.name, self.state.reason)
        else:
            _LOGGER.info("%s -> %s", before.name, phase.name)

    def _begin_feedforward(self) -> None:
        feedforward, report = self._feedforward, self.report
        if feedforward is None:
            return
        feedforward.begin(self._link.support())
        report.feedforward = "recorded" if feedforward.recorded else feedforward.kind
        report.support = feedforward.support
        report.saturated, report.feedforward_changes = feedforward.saturated, feedforward.changes
        if self._correction and feedforward.kind:  # nothing has been commanded yet
            self._correction.correction.require_feedforward(feedforward.kind, feedforward.support)

    def _prepare(self, deadline: int) -> None:
        phase, elapsed = self.state.phase, self.state.elapsed(deadline) / 1e9
        commanded = due = self._targets.at(phase, elapsed)
        if self._feedforward and self._measured and phase is not Phase.DAMP:
            preview = self._feedforward.preview
            effective = self._target_at(deadline + round(preview * 1e9)) if preview else due
            effective = self._corrected(effective)
            age = (self._clock.now() - self._measured.received) / 1e9
            commanded = self._feedforward.command(phase, elapsed, effective, self._imu, age)
        self._compose(due, commanded, deadline)

    def _corrected(self, target: Target) -> Target:
        if self._correction is None:
            return target
        q, dq, ddq = self._correction.at(target.motion_time)
        return target.replace(q=target.q + q, dq=target.dq + dq, ddq=target.ddq + ddq)

    def _target_at(self, then: int) -> Target:
        """The target at a later time, in the phase of that time, if the session continues."""
        state = step(then, self.state, Inputs(), self._undamped)
        return self._targets.at(state.phase, state.elapsed(then) / 1e9)

    def _compose(self, due: Target, commanded: Target, deadline: int) -> None:
        self._prepared = self._composer.compose(
            due, commanded, self.state.phase, self.report.commands, self._ramped(deadline)
        )
        self._prepared_for = deadline
        self.motion_time = due.motion_time
        self._target = due

    def _ramped(self, now: int) -> float:
        """Progress of the ramp to the motion's first frame, 0 to 1."""
        if self.state.phase is not Phase.RAMP:
            return 1.0
        return minimum_jerk(self.state.elapsed(now) / self._timing.ramp)[0]

    def _abort(self, error: BaseException) -> None:
        """The loop itself has failed: damp at the last valid target, whatever its state was."""
        before, start = self.state.phase, self._clock.now()
        # No target yet means that nothing was commanded.
        last = self._target if before < Phase.DONE else None
        reason = f"{type(error).__name__}: {error}"
        self.state = PhaseState(Phase.DAMP if last else Phase.DONE, start, reason)
        try:
            if before < Phase.DAMP:
                self._enter_phase(before)
        finally:
            try:
                if last:
                    self._damp(last.at_rest(), start)
            finally:
                self.state = replace(self.state, phase=Phase.DONE)

    def _damp(self, target: Target, deadline: int) -> None:
        """Damp for as long as configured, and only then raise what failed meanwhile."""
        self._composer.damp()  # the loop may have failed between DAMP and its gains
        failure: BaseException | None = None
        for _ in range(-(-self._timing.damp // self._period)):
            try:
                self._clock.sleep_until(deadline)
                self._compose(target, target, deadline)
                self._publish(deadline)
                deadline = max(deadline + self._period, self._clock.now())
            except BaseException as error:  # noqa: PERF203  a second Ctrl-C too: damping goes on
                failure = failure or error
                deadline += self._period
        if failure:
            raise failure


def make_loop(
    config: Config,
    robot: G1,
    trajectory: Trajectory,
    link: Link,
    clock: Clock,
    *,
    settle: int = _SETTLE,
    recorded: bool = False,
    correction: Correction | None = None,
) -> StreamLoop:
    """The loop that plays a trajectory as configured, not yet running.

    Args:
        config: all settings.
        robot: the robot whose limits and dynamics apply.
        trajectory: the motion.
        link: the wire.
        clock: now, stamp and sleep_until.
        settle: how long other publishers are waited for before the first command, ns.
        recorded: the link replaces the commands of PLAY by recorded ones.
        correction: of the joint targets.

    Raises:
        ConfigError: the interval to play, the gains or the margin to the limits are invalid, or
            the correction is not for this motion and these settings.
        RobotError: the inverse dynamics of this robot cannot be computed.
    """
    settings = config.stream
    interval = Interval.from_config(settings, trajectory.motion)
    period = round(1e9 / settings.rate)  # whole, because deadlines are
    gains = resolve_gains(config.gains)
    spline = None
    if correction:
        _require_fit(correction, settings, robot, trajectory, gains)
        stop = inf if interval.length is None else interval.start + interval.length
        spline = CorrectionSpline(correction, interval.start, stop)
    return StreamLoop(
        link,
        clock,
        Targets(trajectory, start=interval.start, play=interval.length, ramp=settings.ramp),
        Envelope(robot, config.safety),
        Timing.from_config(settings, interval.length, settle=settle + period),
        gains,
        period=period,
        damp_kd=settings.damp_kd,
        allow_second_writer=config.safety.allow_second_writer,
        feedforward=FeedForward.from_config(settings, robot, period / 1e9, recorded=recorded),
        correction=spline,
    )


def _require_fit(
    correction: Correction, settings: StreamConfig, robot: G1, trajectory: Trajectory, gains: Gains
) -> None:
    """Refuse a correction for another motion or settings, as far as they are known now."""
    learned, motion = correction.conditions, trajectory.motion
    correction.require(
        Conditions(
            motion=motion.name,
            motion_sha256=motion.content_sha256,
            robot=robot.name,
            rate=settings.rate,
            kp=gains.kp,
            kd=gains.kd,
            # Without a setting, both are decided when the robot's state and support are known.
            feedforward=settings.feedforward or learned.feedforward,
            support=settings.support or learned.support,
        )
    )
