"""The real-time loop: one thread, absolute deadlines, nothing that can block.

At each deadline it writes what was prepared for it, then takes the newest LowState and prepares the
next command, so that only a write lies between the deadline and the wire.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from g1stream.control.commands import Composer
from g1stream.control.measured import ImuReading, Measured
from g1stream.control.phases import Inputs, PhaseState, Timing, step
from g1stream.control.report import LoopReport
from g1stream.control.ticker import Ticker
from g1stream.dds.messages import LowState
from g1stream.motion.blend import minimum_jerk
from g1stream.types import ERROR, INFO, WARNING, Phase

if TYPE_CHECKING:
    from g1stream.clock import Clock
    from g1stream.control.feedforward import FeedForward
    from g1stream.control.gains import Gains
    from g1stream.control.link import Link
    from g1stream.control.safety import Envelope
    from g1stream.control.target import Target
    from g1stream.control.targets import Targets

__all__ = ["LoopReport", "StreamLoop"]

#: How often the loop looks for a second writer of LowCmd, ns.
_RIVAL_PERIOD = 100_000_000

#: How often it tells of skipped ticks, ns.
_OVERRUN_PERIOD = 1_000_000_000

#: Longer than any session, ns.
_FOR_EVER = 1 << 62


class StreamLoop:
    """Plays targets over a link until the motion ends or something ends it.

    Args:
        link: the wire.
        clock: now, stamp and sleep_until.
        targets: what each phase asks for.
        envelope: limits and verdicts.
        timing: how long each phase lasts.
        gains: kp and kd in every phase but DAMP.
        period: ns between commands.
        damp_kd: kd in DAMP, Nm s/rad.
        settle: for how long others are looked for before the first command, ns.
        allow_rivals: play although somebody else writes LowCmd.
        feedforward: what a command carries beside the position; the velocity alone if left out.

    Attributes:
        state: the phase now.
        motion_time: where in the motion the loop is, s.
        events: (level, text) of what happened; others may pop from its left.
        report: how it goes, and in the end how it went.
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
        settle: int = 300_000_000,
        allow_rivals: bool = False,
        feedforward: FeedForward | None = None,
    ) -> None:
        self._link = link
        self._clock = clock
        self._targets = targets
        self._envelope = envelope
        self._timing = timing
        self._undamped = replace(timing, hold=_FOR_EVER)
        self._composer = Composer(envelope, gains, damp_kd)
        self._period = period
        self._settle = settle
        self._allow_rivals = allow_rivals
        self._feedforward = feedforward
        self._low_state = state = LowState()
        self._imu = ImuReading(state.quaternion, state.gyroscope, state.accelerometer)
        self._measured: Measured | None = None
        self._target: Target | None = None
        self._prepared: tuple[bytes, bytes] | None = None
        self._prepared_for = 0
        self._stop_reason = ""
        self._rivals_due = 0
        self._overruns_told = self._overruns_due = 0
        self.state = PhaseState(Phase.WAIT, 0)
        self.motion_time = 0.0
        self.events: deque[tuple[int, str]] = deque(maxlen=1000)
        self.report = LoopReport(period, envelope.clamped)

    def request_stop(self, reason: str) -> None:
        """End the run through DAMP; may be called from a signal handler or another thread."""
        self._stop_reason = self._stop_reason or reason

    def run(self) -> LoopReport:
        """Play until DONE.

        Whatever goes wrong in here after the first command, the robot is damped before it is
        raised.
        """
        try:
            self._play()
        except BaseException as error:
            self._abort(error)
            raise
        finally:
            self.report.reason = self.state.reason
        return self.report

    def _play(self) -> None:
        self._link.receive(self._low_state)  # this one may be older than it seems
        start = self._clock.now()
        self.state = PhaseState(Phase.WAIT, start)
        ticker = Ticker(self._clock, self._period, start)
        skipped_waiting = 0
        for _, deadline in ticker:
            if self.state.phase is Phase.WAIT:
                skipped_waiting = ticker.skipped
            self.report.skipped = ticker.skipped - skipped_waiting
            self._tick(deadline)
            self._tell_overruns(deadline)
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

    def _tell_overruns(self, deadline: int) -> None:
        """Tell of skipped ticks at once, and then at most once a second."""
        news = self.report.skipped - self._overruns_told
        if not news or (deadline < self._overruns_due and self.state.phase is not Phase.DONE):
            return
        self._overruns_told = self.report.skipped
        self._overruns_due = deadline + _OVERRUN_PERIOD
        self._tell(WARNING, f"overrun: ticks skipped: {news}, {self.report.skipped} so far")

    def _catch_up(self, deadline: int) -> None:
        """Ticks were skipped: the motion stays on time, unless it would leap."""
        gap = deadline - self._prepared_for
        if self.state.phase is Phase.DAMP:
            # Damping lasts as long as it is commanded, not as long as the clock runs.
            self.state = replace(self.state, since=self.state.since + gap)
        else:
            self.request_stop(self._envelope.stalled(gap))
            now = self._clock.now()
            self._receive(now)  # what came meanwhile, before it is judged by its age
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
        self._measured = Measured(state.q, state.dq, state.quaternion, int(state.mode_machine), now)

    def _advance(self, now: int, deadline: int) -> None:
        before = self.state
        stop = self._stop_reason or self._verdict(now) or self._rival(now)
        settled = now - before.since >= self._settle
        missing = self._missing() if before.phase is Phase.WAIT else ""
        inputs = Inputs(settled and not missing, stop, missing)
        self.state = step(deadline, before, inputs, self._timing)
        if self.state.phase is not before.phase:
            self._entered(before.phase)

    def _missing(self) -> str:
        if self._measured is None:
            return "no LowState came"
        return "" if self._link.listeners() else "nobody came to read rt/lowcmd"

    def _verdict(self, now: int) -> str:
        if self._measured is None or self.state.phase >= Phase.DAMP:
            return ""
        return self._envelope.verdict(now, self._measured)

    def _rival(self, now: int) -> str:
        if self._allow_rivals or now < self._rivals_due or self.state.phase >= Phase.DAMP:
            return ""
        if self.state.phase is not Phase.WAIT:  # while waiting nothing is hurried
            self._rivals_due = now + _RIVAL_PERIOD
        rivals = self._link.rivals()
        return f"somebody else writes rt/lowcmd: {', '.join(rivals)}" if rivals else ""

    def _entered(self, before: Phase) -> None:
        phase, measured = self.state.phase, self._measured
        if phase is Phase.RAMP and measured is not None:
            self._targets.begin(measured.q)
            self._composer.begin(measured)
            self._begin_feedforward()
        elif phase is Phase.DAMP:
            self._composer.damp()
        went = f"{before.name} -> {phase.name}"
        if self.state.reason and before < Phase.DAMP:
            self._tell(ERROR, f"{went}: {self.state.reason}")
        else:
            self._tell(INFO, went)

    def _begin_feedforward(self) -> None:
        if self._feedforward is None:
            return
        for level, text in self._feedforward.begin(self._link.support()):
            self._tell(level, text)
        self.report.saturated = self._feedforward.saturated
        self.report.feedforward = self._feedforward.kind or ""
        self.report.support = self._feedforward.support or ""

    def _tell(self, level: int, text: str) -> None:
        self.events.append((level, text))
        self._link.tell(level, text)

    def _prepare(self, deadline: int) -> None:
        phase, elapsed = self.state.phase, self.state.elapsed(deadline) / 1e9
        asked = target = self._targets.at(phase, elapsed)
        if self._feedforward and self._measured and phase is not Phase.DAMP:
            ahead = self._feedforward.preview
            sooner = self._due_at(deadline + round(ahead * 1e9)) if ahead else target
            age = (self._clock.now() - self._measured.received) / 1e9
            asked = self._feedforward.command(phase, elapsed, sooner, self._imu, age)
            for change in self._feedforward.news():
                self.report.feedforward_changes.append(change)
                self._tell(WARNING, str(change))
        self._compose(target, asked, deadline)

    def _due_at(self, then: int) -> Target:
        """What will be asked for, in whichever phase that is, if nothing ends the session."""
        soon = step(then, self.state, Inputs(), self._undamped)
        return self._targets.at(soon.phase, soon.elapsed(then) / 1e9)

    def _compose(self, target: Target, asked: Target, deadline: int) -> None:
        """Prepare what is due, and the command that is to bring it about."""
        self._prepared = self._composer.compose(
            target, asked, self.state.phase, self.report.commands, self._ramped(deadline)
        )
        self._prepared_for = deadline
        self.motion_time = target.motion_time
        self._target = target

    def _ramped(self, now: int) -> float:
        """How much of the way to the motion's first frame lies behind."""
        if self.state.phase is not Phase.RAMP:
            return 1.0
        return minimum_jerk(self.state.elapsed(now) / 1e9 / (self._timing.ramp / 1e9))[0]

    def _abort(self, error: BaseException) -> None:
        """Damp without looking left or right: the loop itself has failed."""
        before, start = self.state.phase, self._clock.now()
        # Whatever failed, this target was whole; before there was one, nothing was commanded.
        whole = self._target if before < Phase.DONE else None
        reason = f"{type(error).__name__}: {error}"
        self.state = PhaseState(Phase.DAMP if whole else Phase.DONE, start, reason)
        try:
            if before < Phase.DAMP:
                self._entered(before)
        finally:
            if whole:
                self._damp(whole.at_rest(), start)
            self.state = replace(self.state, phase=Phase.DONE)

    def _damp(self, target: Target, start: int) -> None:
        n_ticks = -(-self._timing.damp // self._period)
        for _, deadline in islice(Ticker(self._clock, self._period, start), n_ticks):
            self._compose(target, target, deadline)
            self._publish(deadline)
