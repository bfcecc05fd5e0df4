"""Make the LowCmd and the Reference of a tick from target, feed-forward and limits.

Pure: times and measurements are arguments.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from g1stream.control.sources import Moment
from g1stream.dds.messages import LowCmd, Reference, played_bits
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.joints import N_JOINTS
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.feedforward import FeedForward
    from g1stream.control.gains import Gains
    from g1stream.control.limits import CommandLimits
    from g1stream.control.reading import Reading
    from g1stream.control.receiver import Receiver
    from g1stream.control.schedule import Schedule
    from g1stream.control.targets import Setpoint

__all__ = ["Composer", "NextCommand", "Prepared"]

_LOGGER = logging.getLogger(__name__)


class Composer:
    """Makes the LowCmd and the Reference of a tick.

    Args:
        limits: limits of a command.
        gains: kp and kd in all phases except DAMP.
        receiver: the receiver of the commands.
        played: (29,) joints that play the motion, as published in the Reference.
        commanded: (29,) motors that get commands; the slots of the others are 0.

    Attributes:
        limits, receiver: as given; `limits` counts the changes.
    """

    def __init__(
        self,
        limits: CommandLimits,
        gains: Gains,
        receiver: Receiver,
        played: NDArray[np.bool_],
        commanded: NDArray[np.bool_],
    ) -> None:
        self.limits, self.receiver = limits, receiver
        self._servo: Floats = np.stack(gains)
        self._wire = np.zeros((3, N_JOINTS), np.float32)
        self._asked = np.zeros((2, N_JOINTS))
        self._command, self._reference = LowCmd(), Reference()
        self._published = np.zeros(len(self._reference.target), np.float32)
        self._reference.played[()] = played_bits(played)
        self._commanded, self._silent = commanded, np.flatnonzero(~commanded)

    def begin(self, q: NDArray[np.floating], mode_machine: int) -> None:
        """Enable the motors of a robot at the measured pose `q` (29,), rad."""
        self.limits.begin(q)
        command = self._command
        command.motor_mode = self._commanded.astype(np.uint8)
        command.mode_pr[()] = 0  # mode 1 (AB) changes the meaning of ankle and waist joints
        command.mode_machine[()] = mode_machine
        command.kp[:], command.kd[:] = self._servo
        command.q[:] = q

    def damp(self) -> None:
        """Damp from now on, or what the receiver does instead; keeps the last target."""
        self.receiver.damp(self._command)

    def compose(
        self,
        due: Setpoint,
        commanded: Setpoint,
        phase: Phase,
        tick: int,
        *,
        elapsed: float,
        progress: float = 1.0,
        measured: Reading | None = None,
        age: float = 0.0,
    ) -> tuple[bytes, bytes]:
        """Make a LowCmd with its CRC, and its Reference, as they are published.

        Args:
            due: target at the publish time, for the Reference.
            commanded: target of the LowCmd, which takes effect later; its torque is also published
                in the Reference.
            phase: phase of the session.
            tick: number of the Reference.
            elapsed: time since the previous command, s.
            progress: of the way to the first frame, 0 to 1.
            measured: the newest LowState; None: the torque is not limited.
            age: age of `measured` when the command takes effect, s.

        Raises:
            SafetyError: a value of the command is not finite.
        """
        command, reference = self._command, self._reference
        if phase is not Phase.DAMP:  # in DAMP, the command is as `damp` has set it
            asked, wire = self._asked, self._wire
            asked[0], asked[1] = commanded.q, commanded.dq
            wire[:2], wire[2] = asked, commanded.tau
            self.limits.require_finite(wire)
            q_dq, tau = self.limits.apply(
                asked,
                commanded.tau,
                elapsed=elapsed,
                progress=progress,
                gains=self._servo,
                measured=measured,
                age=age,
            )
            (command.q[:], command.dq[:]), command.tau[:] = q_dq, tau
        reference.tick[()] = tick
        reference.phase[()] = phase
        reference.motion_time[()] = due.motion_time
        # From q to root_ang_vel, with the torque of the LowCmd. They are rounded like the LowCmd,
        # because more digits have no meaning and do not compress.
        fields = (*due[1:4], commanded.tau, *due[5:9])
        np.concatenate(fields, out=self._published, casting="same_kind")
        reference.target[:] = self._published
        if len(self._silent):
            for values in (command.q, command.dq, command.tau, command.kp, command.kd):
                values[self._silent] = 0.0
        return self.receiver.seal(command, phase, tick), reference.tobytes()


class Prepared(NamedTuple):
    """A prepared command with its inputs.

    Attributes:
        command: the LowCmd as it is published.
        reference: its Reference as it is published.
        target: the target before feed-forward and limits.
        due: publish time, ns.
        measured: the newest LowState; None before the first.
        steps: steps of a policy for this command, and for those that were prepared but never sent.
    """

    command: bytes
    reference: bytes
    target: Setpoint
    due: int
    measured: Reading | None
    steps: tuple[bytes, ...] = ()


class NextCommand:
    """Prepares each command before its publish time.

    Args:
        schedule: the phases and their targets.
        composer: limits and encodes commands.
        feedforward: velocity and torque of commands.
        period: time between commands, ns.
        soft_start: duration of damping before RAMP, ns, so that the first commands are not stiff.
        clock: returns the time, ns; for the source.

    Attributes:
        composer, feedforward: as given.
        prepared: the newest command; None before the first.
        ahead: the schedule's target when the newest command takes effect.
    """

    def __init__(
        self,
        schedule: Schedule,
        composer: Composer,
        feedforward: FeedForward,
        *,
        period: int,
        soft_start: int = 0,
        clock: Callable[[], int] = lambda: 0,
    ) -> None:
        self.composer, self.feedforward = composer, feedforward
        self.prepared: Prepared | None = None
        self.ahead = schedule.targets.first.at_rest()
        self._schedule = schedule
        self._period = period
        self._soft_start = soft_start
        self._soft_until: int | None = None
        self._clock = clock
        self._steps: tuple[bytes, ...] = ()
        self._sent = 0
        self._sent_for: int | None = None

    @property
    def phase(self) -> Phase:
        """The phase with which commands are published; DAMP during a soft start."""
        return self._schedule.state.phase if self._soft_until is None else Phase.DAMP

    def begin(self, measured: Reading, support: str | None, model: str | None) -> None:
        """Begin RAMP of a robot that announces its support and model; None if it does not."""
        self.feedforward.begin(self._schedule.targets.first, support, model)
        self._ramp_from(measured)
        if self._soft_start:
            self._soft_until = self._schedule.state.since + self._soft_start
            self.composer.damp()

    def _ramp_from(self, measured: Reading) -> None:
        self.composer.begin(measured.q, measured.mode_machine)
        self._schedule.begin_ramp(measured.q)

    def continue_soft_start(self, deadline: int, measured: Reading | None) -> None:
        """Restart RAMP from the measured pose at every tick of the soft start, if there is one."""
        if self._soft_until is None:
            return
        self._schedule.state = self._schedule.state._replace(since=deadline)
        if measured:
            self._ramp_from(measured)
        if deadline < self._soft_until:
            self.composer.damp()
            return
        self._soft_until = None
        _LOGGER.info("soft start: damped for %g s", self._soft_start / 1e9)

    def delay_soft_start(self, gap: int) -> None:
        """Extend the soft start, if any, by `gap` ns in which nothing was sent."""
        if self._soft_until is not None:
            self._soft_until += gap

    def prepare(self, deadline: int, now: int, measured: Reading | None) -> None:
        """Prepare the command that is published at `deadline`."""
        schedule, feedforward = self._schedule, self.feedforward
        commanded = due = self.ahead = schedule.target(deadline, self.ahead)
        if measured and self.phase is not Phase.DAMP:
            if preview := round(feedforward.preview * 1e9):
                self.ahead = schedule.target_ahead(deadline + preview, due)
            age = (now - measured.arrived) / 1e9
            time = (deadline - schedule.delayed) / 1e9
            ramped = schedule.ramped(deadline)
            moment = Moment(
                self.phase, ramped, self.ahead, measured, age, time, self._sent, self._clock
            )
            commanded = feedforward.command(moment)
            # The message of a command that is replaced before it is sent goes with the next one.
            if step := feedforward.status.step:
                self._steps = (*self._steps, step)
        self.compose(due, commanded, deadline, measured)

    def compose(
        self, due: Setpoint, commanded: Setpoint, deadline: int, measured: Reading | None
    ) -> None:
        """Limit and encode the target `commanded`, with `due` as the reference."""
        since = deadline - self._period if self._sent_for is None else self._sent_for
        command, reference = self.composer.compose(
            due,
            commanded,
            self.phase,
            self._sent,
            elapsed=(deadline - since) / 1e9,
            progress=minimum_jerk(self._schedule.ramped(deadline))[0],
            measured=measured,
            age=(deadline - measured.arrived) / 1e9 if measured else 0.0,
        )
        self.prepared = Prepared(command, reference, due, deadline, measured, self._steps)

    def sent(self) -> None:
        """Note that the newest command has been sent."""
        self.composer.limits.sent()
        self._sent += 1
        self._steps = ()
        if self.prepared:
            self._sent_for = self.prepared.due
