"""The real-time loop: one thread, absolute deadlines, nothing that can block.

At each deadline it writes what was prepared for it, then takes the newest LowState and prepares the
next command, so that only a write lies between the deadline and the wire.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

from g1stream.clock import Ticker
from g1stream.control.commands import MAX_STEP_TIME, Composer
from g1stream.control.feedforward import FeedForward
from g1stream.control.other_publishers import OtherPublishers
from g1stream.control.overruns import Overruns
from g1stream.control.phases import Inputs, PhaseState, Timing, step
from g1stream.control.report import LoopReport
from g1stream.control.safety import Safety
from g1stream.control.targets import Targets
from g1stream.dds.messages import LowState
from g1stream.dds.topics import LOWCMD, Topic
from g1stream.errors import G1StreamError, SafetyError
from g1stream.motion.blend import COAST, minimum_jerk
from g1stream.motion.correction import CorrectionSpline
from g1stream.text import counted
from g1stream.types import Phase

if TYPE_CHECKING:
    from g1stream.clock import Clock
    from g1stream.control.link import Link
    from g1stream.control.state_checks import Measured
    from g1stream.control.targets import Target
    from g1stream.types import Floats

__all__ = ["LoopReport", "Newest", "StreamLoop"]

_LOGGER = logging.getLogger(__name__)

#: Time of the motion that one command may pass, ns.
_CATCH_UP: Final = round(MAX_STEP_TIME * 1e9)
#: What RAMP waits for is said again after this, ns.
_TOLD_AGAIN: Final = 3_000_000_000
#: Longer than any session, ns.
_FOREVER: Final = 1 << 62


class Newest(NamedTuple):
    """What the newest command was made of.

    Attributes:
        target: before feed-forward and limits.
        due: when it is published, ns of CLOCK_MONOTONIC.
        measured: the newest LowState; None before the first.
    """

    target: Target
    due: int
    measured: Measured | None


class StreamLoop:
    """Plays targets over a link until the motion ends or something stops it.

    Phase changes, overruns and reasons to stop are logged; the logger must not block, see
    `g1stream.events.handled_by`.

    Args:
        link: the wire.
        clock: now, stamp and sleep_until.
        targets: the target of each phase.
        safety: the checks of what is received.
        overruns: the ticks that the loop misses.
        timing: length of each phase.
        composer: makes the commands.
        period: ns between commands.
        allow_second_writer: play although there is another publisher of LowCmd.
        feedforward: what a command carries beside the position; the velocity alone if left out.
        soft_start: ns of DAMP before RAMP, so that the first commands are not stiff.
        topic: of the commands: LOWCMD, or ARM_SDK.
        correction: added to the joint targets of the commands, not to the published reference;
            needs a feed-forward.

    Attributes:
        state: the current phase.
        motion_time: where in the motion the loop is, s.
        damped: whether the last command damped; also true before the first one.
        newest: what the newest command was made of, for other threads to read; None before the
            first.
        stop_requests: how often `request_stop` was called, also after the end.
        report: counts and timing so far, and in the end of the whole run.
    """

    def __init__(
        self,
        link: Link,
        clock: Clock,
        targets: Targets,
        safety: Safety,
        overruns: Overruns,
        timing: Timing,
        composer: Composer,
        *,
        period: int,
        allow_second_writer: bool = False,
        feedforward: FeedForward | None = None,
        soft_start: int = 0,
        topic: Topic = LOWCMD,
        correction: CorrectionSpline | None = None,
    ) -> None:
        self._link = link
        self._clock = clock
        self._targets = targets
        self._safety = safety
        self._overruns = overruns
        self._timing = timing
        self._composer = composer
        self._period = period
        self._others = OtherPublishers(link, allow_second_writer=allow_second_writer, topic=topic)
        self._topic = topic
        self._feedforward = feedforward
        self._soft_start = soft_start
        self._soft_until: int | None = None
        self._told = -_TOLD_AGAIN  # when in RAMP it was said that it waits, ns
        self._correction = correction
        self._low_state = LowState()
        self._measured: Measured | None = None
        self._skipped_when_measured = 0
        self._target: Target | None = None
        self._prepared: tuple[bytes, bytes] | None = None
        self._prepared_for = self._published_for = 0
        self._requested = ""  # to end the run, when there is time
        self._stop_reason = ""  # to end it at once
        self.state = PhaseState(Phase.WAIT, 0)
        self.motion_time = 0.0
        self.damped = True
        self.newest: Newest | None = None
        self.stop_requests = 0
        self.report = LoopReport(period, composer.limits)

    def request_stop(self, reason: str) -> None:
        """End the run through DAMP; may be called from a signal handler or another thread.

        A robot on its feet squats down before; a second request damps it at once.
        """
        self._requested = self._requested or reason
        self.stop_requests += 1

    def run(self) -> LoopReport:
        """Play until DONE.

        On any error after the first command, the robot is damped before the error is raised.

        Raises:
            SafetyError: before the first command, there is another publisher of LowCmd, or more
                than one of LowState.
        """
        try:
            self._play()
        except BaseException as error:
            self._abort(error)
            raise
        finally:
            self.report.reason = self.state.reason
            self.report.crc_errors = self._safety.crc_errors
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
            self._overruns.count(deadline, self.report.skipped, self.state.phase)
            if self.state.phase is Phase.DONE:
                break

    def _tick(self, deadline: int) -> None:
        self._yield_to_guard(deadline)
        if self._prepared and self._prepared_for != deadline:
            self._catch_up(deadline)
        self._yield_to_guard(deadline)  # again, so that little time is left for it to begin in
        self._publish(deadline)
        if self._yield_to_guard(deadline):  # it began just before our command
            self._publish(deadline)
        begun = self._clock.now()
        self._receive(begun)
        self._advance(begun, deadline + self._period)
        if Phase.WAIT < self.state.phase < Phase.DONE:
            self._prepare(deadline + self._period)
        if self.report.commands:
            self.report.worst_work = max(self.report.worst_work, self._clock.now() - begun)

    def _yield_to_guard(self, deadline: int) -> bool:
        """Change to DAMP if the guard process has begun to damp the robot; whether it has."""
        if not self._prepared or self.state.phase >= Phase.DAMP:
            return False
        if not (reason := self._link.replaced()):
            return False
        self._stop_reason = self._stop_reason or reason
        self._advance(self._clock.now(), deadline)
        self._prepare(deadline)
        return True

    def _catch_up(self, deadline: int) -> None:
        """After skipped ticks: go on a little further in the motion, or stop after too many.

        The target moves on by no more than `MAX_STEP_TIME`; the rest of the time is added to the
        phase, so that the motion ends later instead of leaping.
        """
        gap = deadline - self._prepared_for
        # Damping is as long as configured with commands; time without any does not count.
        if self._soft_until is not None:
            self._soft_until += gap
        if self.state.phase is Phase.DAMP:
            self.state = replace(self.state, since=self.state.since + gap)
        else:
            if stalled := self._overruns.stalled(gap):
                self._stop_reason = self._stop_reason or stalled
            delay = max(0, gap - max(0, _CATCH_UP - self._period))
            self.state = replace(self.state, since=self.state.since + delay)
            self.report.delay += delay
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
        self.damped = self.state.phase is Phase.DAMP
        report.lateness.add(self._link.send(command, reference, stamp) - deadline)
        report.commands += 1
        self._published_for = self._prepared_for
        self._composer.sent()
        report.first_stamp = report.first_stamp or stamp
        report.last_stamp = stamp

    def _receive(self, now: int) -> None:
        publisher = self._link.receive(self._low_state)
        if publisher is None:
            return
        measured = self._safety.take(self._low_state, publisher, now, self._target_q)
        if measured is None:
            return
        self.report.states += 1
        self._skipped_when_measured = self.report.skipped
        self._measured = measured
        if self._feedforward:
            q, dq, tau = measured.q, measured.dq, measured.tau
            self._feedforward.observe(now / 1e9, q, dq, tau, measured.imu)

    @property
    def _target_q(self) -> Floats | None:
        """(29,) rad, the newest joint targets; None before the first command."""
        return self._target.q if self._target else None

    def _advance(self, now: int, deadline: int) -> None:
        if self._requested:
            self._end_as_requested(deadline)
        before = self.state
        if self._feedforward and before.phase is Phase.RAMP:
            self._wait_in_ramp(self._feedforward.awaited(), before.elapsed(deadline))
        unknown = self._robot_unknown(now)
        missing = ""
        if before.phase is Phase.WAIT:
            missing = unknown or self._safety.missing() or self._no_subscriber()
        inputs = Inputs(missing, self._reason_to_stop(now, unknown))
        self.state = step(deadline, before, inputs, self._timing)
        if self.state.phase is not before.phase:
            self._enter_phase(before.phase)
        elif self._soft_until is not None and self.state.phase is Phase.RAMP:
            self._damp_before_ramp(deadline)

    def _wait_in_ramp(self, awaited: str, elapsed: int) -> None:
        """Let RAMP end, at rest, no earlier than what the feed-forward waits for has come."""
        end = elapsed + self._period + round(COAST * 1e9)
        if not awaited or end <= self._timing.ramp:
            return
        if elapsed >= self._told + _TOLD_AGAIN:
            self._told = elapsed
            _LOGGER.info("RAMP waits: %s", awaited)
        self._timing = replace(self._timing, ramp=end)
        self._targets.ramp_end = end / 1e9

    def _end_as_requested(self, deadline: int) -> None:
        """End PLAY or HOLD once there is a way down from there, and a run without one at once."""
        state = self.state
        standing = self._targets.squats and state.phase in (Phase.PLAY, Phase.HOLD)
        if not standing or self.stop_requests > 1:
            self._stop_reason = self._stop_reason or self._requested
        elif not state.reason and self._targets.may_end():
            play, elapsed = self._timing.play or 0, state.elapsed(deadline)
            if state.phase is Phase.PLAY:
                play, elapsed = elapsed, 0
            hold = min(self._timing.hold, max(elapsed, round(COAST * 1e9)))
            self._targets.end(play / 1e9, hold / 1e9)
            self._timing = replace(self._timing, play=play, hold=hold)
            self.state = replace(state, reason=self._requested)

    def _no_subscriber(self) -> str:
        if not self._link.subscribers():
            return f"no subscriber on {self._topic.name}"
        return self._link.unguarded()

    def _robot_unknown(self, now: int) -> str:
        """Why nothing is known of the robot now, or "" where it is."""
        fault = self._safety.unknown(now, self._target_q)
        skipped = self.report.skipped - self._skipped_when_measured
        if fault and skipped:
            fault += (
                f"; this machine stalled: the loop skipped {counted(skipped, 'tick')} meanwhile"
            )
        return fault

    def _reason_to_stop(self, now: int, unknown: str) -> str:
        phase = self.state.phase
        if self._stop_reason or phase >= Phase.DAMP:
            return self._stop_reason
        if unknown and phase is not Phase.WAIT:
            return self._others.of_state() or unknown
        wrong = "" if unknown else self._safety.verdict()
        if self._feedforward:
            wrong = wrong or self._feedforward.verdict()
        if wrong := wrong or self._overruns.verdict():
            return wrong
        other = self._others.verdict(now, waiting=phase is Phase.WAIT)
        if other and phase is Phase.WAIT:
            raise SafetyError(
                f"There is {other}; nothing was sent.",
                "End the program that must not publish there, or choose another --domain; "
                "`g1stream robot release` releases the robot's own controller.",
            )
        return other

    def _enter_phase(self, before: Phase) -> None:
        phase, measured = self.state.phase, self._measured
        if phase is Phase.RAMP and measured is not None:
            self._safety.begin()
            self._begin_feedforward()
            self._begin(measured)
            if self._soft_start:
                self._soft_until = self.state.since + self._soft_start
                self._composer.damp()
        elif phase is Phase.DAMP:
            self._composer.damp()
        if self.state.reason and before < Phase.DAMP:
            _LOGGER.error("%s -> %s: %s", before.name, phase.name, self.state.reason)
        else:
            _LOGGER.info("%s -> %s", before.name, phase.name)

    def _damp_before_ramp(self, deadline: int) -> None:
        """Begin RAMP anew from the pose measured now, until the soft start is over."""
        self.state = replace(self.state, since=deadline)
        if self._measured:
            self._begin(self._measured)
        if self._soft_until is not None and deadline < self._soft_until:
            self._composer.damp()
            return
        self._soft_until = None
        _LOGGER.info("soft start: damped for %g s", self._soft_start / 1e9)

    def _begin(self, measured: Measured) -> None:
        """Begin RAMP at the measured pose."""
        self._composer.begin(measured.q, measured.mode_machine)
        self.report.ramp = ramp = self._targets.begin(measured.q)
        self._timing = replace(self._timing, ramp=round(ramp.length * 1e9))
        self._told = -_TOLD_AGAIN
        if self._feedforward:
            self._feedforward.ramp = ramp.length
            self._feedforward.ramp_to(self._targets.first)

    def _begin_feedforward(self) -> None:
        feedforward, report = self._feedforward, self.report
        if feedforward is None:
            return
        feedforward.begin(self._link.support(), self._link.model())
        report.feedforward = "recorded" if feedforward.recorded else feedforward.kind
        report.support = feedforward.support
        report.preview = None if feedforward.recorded else feedforward.preview
        report.saturated, report.feedforward_changes = feedforward.saturated, feedforward.changes
        if self._correction and feedforward.kind:  # nothing has been commanded yet
            self._correction.correction.require_feedforward(feedforward.kind, feedforward.support)

    def _prepare(self, deadline: int) -> None:
        phase, elapsed = self.state.phase, self.state.elapsed(deadline) / 1e9
        commanded = due = self._targets.at(phase, elapsed)
        soft = phase is Phase.DAMP or self._soft_until is not None
        if self._feedforward and self._measured and not soft:
            preview = self._feedforward.preview
            effective = self._target_at(deadline + round(preview * 1e9)) if preview else due
            effective = self._corrected(effective)
            age = (self._clock.now() - self._measured.received) / 1e9
            commanded = self._feedforward.command(
                phase, elapsed, effective, self._measured.imu, age
            )
        self._compose(due, commanded, deadline)

    def _corrected(self, target: Target) -> Target:
        if self._correction is None:
            return target
        q, dq, ddq = self._correction.at(target.motion_time)
        return target.replace(q=target.q + q, dq=target.dq + dq, ddq=target.ddq + ddq)

    def _target_at(self, then: int) -> Target:
        """The target at a later time, in the phase of that time, if the session continues."""
        state = step(then, self.state, Inputs(), replace(self._timing, hold=_FOREVER))
        return self._targets.at(state.phase, state.elapsed(then) / 1e9)

    def _compose(self, due: Target, commanded: Target, deadline: int) -> None:
        phase = self.state.phase if self._soft_until is None else Phase.DAMP
        since = self._published_for or deadline - self._period
        measured = self._measured
        self._prepared = self._composer.compose(
            due,
            commanded,
            phase,
            self.report.commands,
            elapsed=(deadline - since) / 1e9,
            ramped=self._ramped(deadline),
            measured=measured,
            age=(deadline - measured.received) / 1e9 if measured else 0.0,
        )
        if fault := self._composer.limits.fault:
            self._stop_reason = self._stop_reason or fault
        self._prepared_for = deadline
        self.motion_time = due.motion_time
        self._target = due
        self.newest = Newest(due, deadline, measured)

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
        if isinstance(error, G1StreamError):
            reason = error.cause.rstrip(".")
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
