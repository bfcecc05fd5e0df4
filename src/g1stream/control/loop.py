"""The real-time loop: one thread with absolute deadlines and no blocking calls.

At each deadline it writes the prepared command, then takes the newest LowState and prepares the
next command, so that only a write lies between the deadline and DDS.
"""

from __future__ import annotations

import logging
from math import inf
from typing import TYPE_CHECKING, Final

from g1stream.clock import Ticker
from g1stream.control.command import Composer, NextCommand
from g1stream.control.feedforward import FeedForward
from g1stream.control.limits import MAX_STEP_TIME, CommandLimits
from g1stream.control.link import OtherPublishers
from g1stream.control.lowstate import LowStateChecks
from g1stream.control.report import LoopReport, Overruns
from g1stream.control.robot_clock import RobotClock
from g1stream.control.schedule import Inputs, PhaseState, Schedule
from g1stream.control.stop import Stop
from g1stream.control.targets import COAST_NS, Targets, Timing
from g1stream.dds.domain import SETTLE
from g1stream.dds.messages import LowState
from g1stream.errors import G1StreamError, SafetyError
from g1stream.network import network_name
from g1stream.text import counted
from g1stream.types import Phase

if TYPE_CHECKING:
    from g1stream.clock import Clock
    from g1stream.control.command import Prepared
    from g1stream.control.link import Link
    from g1stream.control.plan import Plan
    from g1stream.control.reading import Reading
    from g1stream.control.targets import Setpoint
    from g1stream.types import Floats

__all__ = ["StreamLoop", "make_loop"]

_LOGGER = logging.getLogger(__name__)

#: Time of the first log message about what WAIT waits for, and interval of the next ones, ns.
_FIRST_WAIT_LOG, _WAIT_LOG_INTERVAL = 1_000_000_000, 3_000_000_000
#: Maximum motion time between two commands, ns.
_CATCH_UP: Final = round(MAX_STEP_TIME * 1e9)


class StreamLoop:
    """Plays targets over a link until the motion ends or something stops it.

    It logs phase changes, overruns and reasons to stop. The logger must not block, see
    `g1stream.events.handled_by`.

    Args:
        link: the link to the robot.
        clock: provides now, stamp and sleep_until.
        schedule: the phases and their targets.
        commands: prepares commands from the targets of `schedule`.
        checks: checks of received LowStates.
        overruns: counts the ticks that the loop misses.
        period: time between commands, ns.
        allow_second_writer: play even if there is another publisher of LowCmd.
        wait_for: event after which a resting motion goes on.
        where: DDS domain and network of the robot, for log messages.

    Attributes:
        damped: whether the last command was sent in DAMP; also true before the first one.
        stop_requests: number of calls of `request_stop`, including those after the end.
        wait_for: as given.
        report: counts and timing so far, and finally of the whole run.
    """

    def __init__(
        self,
        link: Link,
        clock: Clock,
        schedule: Schedule,
        commands: NextCommand,
        checks: LowStateChecks,
        overruns: Overruns,
        *,
        period: int,
        allow_second_writer: bool = False,
        wait_for: str | None = None,
        where: str = "",
    ) -> None:
        self._link = link
        self._clock = clock
        self._schedule = schedule
        self._commands = commands
        self._feedforward = commands.feedforward
        self._robot_clock = commands.feedforward.robot_clock
        self._checks = checks
        self._overruns = overruns
        self._period = period
        self._receiver = receiver = commands.composer.receiver
        self._others = OtherPublishers(
            link, allow_second_writer=allow_second_writer, topic=receiver.topic
        )
        self._where, self._next_wait_log = where, _FIRST_WAIT_LOG
        self.wait_for = wait_for
        self._unheard: Stop | None = None  # why nothing lets a resting motion go on
        self._gone_on = self._to_go_on = 0
        self._low_state = LowState()
        self._measured: Reading | None = None
        self._skipped_when_measured = 0
        self._requested: Stop | None = None  # after the way down, if there is one
        self._stop: Stop | None = None  # immediately
        self.damped = True
        self.stop_requests = 0
        self.report = LoopReport(
            period,
            schedule,
            commands.composer.limits,
            commands.feedforward,
            checks,
        )

    @property
    def state(self) -> PhaseState:
        """The current phase."""
        return self._schedule.state

    @property
    def newest(self) -> Prepared | None:
        """The newest command, for other threads to read; None before the first."""
        return self._commands.prepared

    @property
    def motion_time(self) -> float:
        """Current time in the motion, s."""
        return self.newest.target.motion_time if self.newest else 0.0

    @property
    def part(self) -> tuple[float, float]:
        """Motion times at which PLAY begins and ends, s; infinity if it has no end."""
        start, length = self._schedule.targets.first.motion_time, self._schedule.timing.play
        return start, inf if length is None else start + length / 1e9

    def request_stop(self, reason: str | Stop) -> None:
        """End the run through DAMP; can be called from a signal handler or another thread.

        A balancing robot goes down first; a second request damps it immediately.

        Args:
            reason: why the run ends, logged when DAMP begins.
        """
        if not self._requested:
            asked = reason if isinstance(reason, Stop) else Stop("requested", reason)
            self._requested = asked
        self.stop_requests += 1

    def go_on(self) -> None:
        """End the present rest of the motion; can be called from another thread."""
        self._to_go_on += 1

    def end_at_rest(self, reason: str) -> None:
        """End at the next rest that nothing ends any more, for this reason."""
        self._unheard = Stop("requested", reason)

    def end_for_error(self, stop: Stop) -> None:
        """Request a stop, unless one is requested; a second one would skip the way down."""
        if not self.stop_requests:
            self.request_stop(stop)

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
        return self.report

    def _play(self) -> None:
        self._link.receive(self._low_state)  # discarded, because it may be older than this run
        start = self._clock.now()
        self._schedule.state = PhaseState(Phase.WAIT, start)
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
        if self.newest and self.newest.due != deadline:
            self._catch_up(deadline, deadline - self.newest.due)
        self._send(deadline)  # what the tick before has prepared
        begun, following = self._clock.now(), deadline + self._period
        self._take(begun)  # a Reading of the newest LowState
        self._step(begun, following, self._judge(begun, following))  # WAIT to DONE
        if Phase.WAIT < self.state.phase < Phase.DONE:
            self._prepare(following)  # the reference, the source, the limits, the bytes
        if self.report.commands:
            self.report.worst_work = max(self.report.worst_work, self._clock.now() - begun)

    def _yield_to_guard(self, deadline: int) -> None:
        """Change to DAMP if the guard process damps the robot."""
        if not self.newest or self.state.phase >= Phase.DAMP:
            return
        if stop := self._replaced():
            self._stop = self._stop or stop
            now = self._clock.now()
            self._step(now, deadline, self._judge(now, deadline))
            self._prepare(deadline)

    def _catch_up(self, deadline: int, gap: int) -> None:
        """Continue after ticks were skipped for `gap` ns, or stop after too long a stall.

        The target advances by at most `MAX_STEP_TIME`. The rest of the time is added to the phase,
        so that the motion ends later instead of jumping.
        """
        # Only time with commands counts towards the configured duration of damping.
        self._commands.delay_soft_start(gap)
        if self.state.phase is Phase.DAMP:
            self._schedule.delay(gap)
        else:
            if stalled := self._overruns.stalled(gap):
                self._stop = self._stop or stalled
            delay = max(0, gap - max(0, _CATCH_UP - self._period))
            self._schedule.delay(delay)
            if self._robot_clock.followed:
                self._robot_clock.delay += delay
            else:
                self.report.delay += delay
            now = self._clock.now()
            self._take(now)  # first, because the age of the newest state is checked next
            self._step(now, deadline, self._judge(now, deadline))
        self._prepare(deadline)

    def _send(self, deadline: int) -> None:
        """Publish the newest command and its Reference."""
        prepared = self.newest
        if prepared is None:
            return
        stamp = self._clock.stamp()
        written = self._link.send(prepared.command, prepared.reference, stamp)
        if not written:
            return
        for data in prepared.steps:
            self._link.send_step(data, stamp)
        report = self.report
        self.damped = self.state.phase is Phase.DAMP
        report.lateness.add(written - deadline)
        report.commands += 1
        self._commands.sent()
        report.error.asked(stamp, prepared.target, playing=self.state.phase is Phase.PLAY)
        report.first_sent = report.first_sent or written
        report.last_sent = written

    def _take(self, now: int) -> None:
        """Check the newest LowState, and keep its reading unless it is dropped."""
        publisher = self._link.receive(self._low_state)
        if publisher is None:
            return
        measured = self._checks.take(self._low_state, publisher, now, self._target_q)
        if measured is None:
            return
        self.report.states += 1
        self._skipped_when_measured = self.report.skipped
        self._measured = measured
        self.report.error.received(measured)
        if self._checks.go_on:
            self.go_on()
        moving = Phase.WAIT < self._commands.phase < Phase.DAMP
        self._robot_clock.take(measured, moving=moving)

    @property
    def _target_q(self) -> Floats | None:
        """(29,) rad, the newest joint targets; None before the first command."""
        return self.newest.target.q if self.newest else None

    def _judge(self, now: int, deadline: int) -> Inputs:
        """Why the first command has to wait, and why the run has to end."""
        if self._requested:
            self._end_as_requested(deadline, self._requested)
        state, missing = self.state, ""
        unknown = self._robot_unknown(now)
        if state.phase is Phase.WAIT:
            missing = unknown or self._checks.missing or self._link.unready()
            if missing and state.elapsed(now) >= self._next_wait_log:
                self._next_wait_log = state.elapsed(now) + _WAIT_LOG_INTERVAL
                longest = self._schedule.timing.wait / 1e9
                _LOGGER.info("WAIT, up to %g s, in %s: %s", longest, self._where, missing)
        stop = self._reason_to_stop(now, unknown)
        if stop and state.phase < Phase.DAMP:  # commands of the guard look like another writer
            stop = self._replaced() or stop
        return Inputs(missing, stop)

    def _step(self, now: int, deadline: int, inputs: Inputs) -> None:
        """Advance to the phase of the command at `deadline`."""
        before = self.state
        if before.phase is Phase.RAMP:
            self._schedule.wait_in_ramp(deadline, self._feedforward.status.awaited)
        elif self._robot_clock.followed and before.phase in (Phase.PLAY, Phase.HOLD):
            self._schedule.delay(self._robot_clock.wait(now))
            self.report.waited = self._robot_clock.delay
        self._rest(deadline)
        self._schedule.advance(deadline, inputs)
        if self.state.phase is not before.phase:
            self._enter_phase(before)
        elif self.state.phase is Phase.RAMP:
            self._commands.continue_soft_start(deadline, self._measured)

    def _rest(self, now: int) -> None:
        """Let the motion rest where it has to, until it is told to go on."""
        rested = self._schedule.resting
        if not self._schedule.rest(now):
            return
        if not rested:
            self._gone_on = self._to_go_on  # what came earlier does not count
            what = "Enter" if self.wait_for == "enter" else f"{self.wait_for} on the remote"
            _LOGGER.info("PLAY waits at %.2f s: press %s", self.motion_time, what)
        elif self._to_go_on > self._gone_on:
            self._schedule.go_on()
            _LOGGER.info("PLAY goes on")
        elif self._unheard:
            self.end_for_error(self._unheard)

    def _replaced(self) -> Stop | None:
        """Why the run must end because the guard process has taken over, or None."""
        why = self._link.replaced()
        return Stop("guard", why) if why else None

    def _end_as_requested(self, deadline: int, requested: Stop) -> None:
        """End the run, after the way down if the source has one and it is possible."""
        if self.stop_requests > 1 or not self._schedule.go_down(
            deadline,
            requested,
            self._commands.ahead,
            stands=self._feedforward.status.stands,
        ):
            self._stop = self._stop or requested

    def _robot_unknown(self, now: int) -> str:
        """Why the state of the robot is unknown, or ""."""
        fault = self._checks.unknown(now, self._target_q)
        skipped = self.report.skipped - self._skipped_when_measured
        if fault and skipped:
            fault += f"; this machine stalled, and the loop skipped {counted(skipped, 'tick')}"
        return fault

    def _reason_to_stop(self, now: int, unknown: str) -> Stop | None:
        phase = self.state.phase
        if self._stop or phase >= Phase.DAMP:
            return self._stop
        if unknown and phase is not Phase.WAIT:
            return self._others.of_state() or Stop("state", unknown)
        wrong = None if unknown else self._checks.stop
        if wrong := wrong or self._feedforward.stop() or self._overruns.stop():
            return wrong
        other = self._others.stop(now, waiting=phase is Phase.WAIT)
        if other and phase is Phase.WAIT:
            raise SafetyError(
                f"There is {other.text}; nothing was sent.",
                f"{self._receiver.end_other} Or use another --domain.",
            )
        return other

    def _enter_phase(self, before: PhaseState) -> None:
        phase, measured = self.state.phase, self._measured
        if before.phase is Phase.PLAY:
            self.report.played = self.state.since - before.since
        if phase is Phase.RAMP and measured is not None:
            self._commands.begin(measured, *self._link.announced())
            self._checks.begin("free" if self._receiver.carries else self._feedforward.mode.support)
        elif phase is Phase.PLAY:
            self._robot_clock.begin(self._clock.now())
            if self._robot_clock.followed:  # a policy makes the targets
                self._checks.need_not_follow()
        elif phase is Phase.DAMP:
            self._commands.composer.damp()
        change = f"{before.phase.name} -> {phase.name}"
        stop = self.state.stop if before.phase < Phase.DAMP else None
        level = logging.ERROR if stop and stop.kind != "signal" else logging.INFO
        _LOGGER.log(level, f"{change}: {stop.text}" if stop else change)
        if phase is Phase.DAMP and self._receiver.carries:
            _LOGGER.info("the stream %s", self._receiver.ending)

    def _prepare(self, deadline: int) -> None:
        self._commands.prepare(deadline, self._clock.now(), self._measured)
        if fault := self._commands.composer.limits.speed.fault:
            self._stop = self._stop or Stop("target", fault)

    def _abort(self, error: BaseException) -> None:
        """After a failure of the loop itself, damp at the last valid target."""
        before, start = self.state, self._clock.now()
        # Without a target, nothing was commanded.
        last = self.newest.target if self.newest and before.phase < Phase.DONE else None
        reason = f"{type(error).__name__}: {error}"
        if isinstance(error, G1StreamError):
            reason = f"{error.cause} {error.remedy}".strip().rstrip(".")
        self._schedule.state = PhaseState(
            Phase.DAMP if last else Phase.DONE, start, Stop("error", reason)
        )
        try:
            if last and before.phase < Phase.DAMP:  # otherwise the raised error is sufficient
                self._enter_phase(before)
        finally:
            try:
                if last:
                    self._damp(last.at_rest(), start)
            finally:
                self._schedule.state = self.state._replace(phase=Phase.DONE)

    def _damp(self, target: Setpoint, deadline: int) -> None:
        """Damp for the configured time, then raise the first error of that time."""
        self._commands.composer.damp()  # the loop may have failed between DAMP and its gains
        failure: BaseException | None = None
        for _ in range(-(-self._schedule.timing.damp // self._period)):
            try:
                self._clock.sleep_until(deadline)
                self._commands.compose(target, target, deadline, self._measured)
                self._send(deadline)
                deadline = max(deadline + self._period, self._clock.now())
            except BaseException as error:  # noqa: PERF203  damping continues, also after Ctrl-C
                failure = failure or error
                deadline += self._period
        if failure:
            raise failure


def make_loop(
    plan: Plan, link: Link, clock: Clock, *, settle: int = round(SETTLE * 1e9), block: int = 1
) -> StreamLoop:
    """Make the loop that plays a plan, without starting it.

    Args:
        plan: the motion, robot and settings.
        link: the link to the robot.
        clock: provides now, stamp and sleep_until.
        settle: minimum time in which other publishers are discovered before the first command, ns.
        block: ticks of PLAY that are sampled together; more than one only without a wall clock.

    Raises:
        ConfigError: the margin to the limits leaves no range for a joint, or a setting is not a
            button of the remote.
    """
    config, settings, robot = plan.config, plan.config.stream, plan.robot
    period, receiver, traits = settings.period, plan.receiver, plan.source.traits
    limits = CommandLimits(
        robot, config.safety, settings.beyond_limits, in_steps=traits.makes_targets
    )
    composer = Composer(limits, plan.gains, receiver, plan.played, plan.commanded)
    timing = Timing.from_config(settings, plan.interval.length, settle + period)
    if down := traits.way_down:
        hold = max(timing.hold, COAST_NS)
        timing = timing._replace(hold=hold, way_down=round(1e9 * down.length))
    start = plan.interval.start
    ticks = range(0, block * period, period)
    targets = Targets(plan.trajectory, start=start, moved=plan.moved, way_down=down, block=ticks)
    rests = [round(1e9 * (rest - start)) for rest in plan.rests if rest > start]
    schedule = Schedule(targets, timing, period, config.constants.ramp_speed, rests)
    feedforward = FeedForward(
        plan.source,
        limit=robot.torque_limit * plan.held,
        period=period / 1e9,
        preview=settings.preview,
        robot_clock=RobotClock(config.constants.time_scale, followed=traits.makes_targets),
        delay=robot.parameters.command_delay,
        torque_scale=robot.parameters.torque_scale,
    )
    return StreamLoop(
        link,
        clock,
        schedule,
        NextCommand(
            schedule,
            composer,
            feedforward,
            period=period,
            soft_start=0 if receiver.carries else round(config.constants.soft_start * 1e9),
            clock=clock.now,
        ),
        LowStateChecks(
            robot, plan.held, config.safety, config.constants, period, settings.wait_for
        ),
        Overruns(period, config.safety, config.constants),
        period=period,
        allow_second_writer=config.safety.allow_second_writer,
        wait_for=settings.wait_for,
        where=f"domain {config.dds.domain} on {network_name(config.dds.interface)}",
    )
