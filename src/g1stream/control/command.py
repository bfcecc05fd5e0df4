"""The command of a tick: of the target, feed-forward and limits, as a LowCmd and its Reference.

Through rt/arm_sdk only arms and waist get targets, which the robot's own controller blends into its
own while it stands, walks and balances. A weight w from 0 to 1 says how much of arms and waist is
ours: the motors get (1 - w) of its command and w of ours. It keeps the last weight that it was
sent, whoever sent it, so that whoever raised it has to bring it back to 0.

Pure: times and measurements come in as arguments.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.control.sources import Moment
from g1stream.dds.messages import LowCmd, Reference, played_bits
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.joints import N_JOINTS, select_joints
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from g1stream.control.feedforward import FeedForward
    from g1stream.control.gains import Gains
    from g1stream.control.limits import CommandLimits
    from g1stream.control.reading import Reading
    from g1stream.control.schedule import Schedule
    from g1stream.control.targets import Target

__all__ = [
    "HAND_BACK_TIME",
    "MOVED",
    "WEIGHT_TIME",
    "ArmSdkComposer",
    "Composer",
    "NextCommand",
    "Prepared",
    "hand_back_commands",
]

_LOGGER = logging.getLogger(__name__)

WEIGHT_TIME: Final = 2.0
"""Time in which the weight of rt/arm_sdk goes from 0 to 1, and back, s: Unitree's examples'."""

HAND_BACK_TIME: Final = WEIGHT_TIME + 0.05
"""How long arms and waist are handed back at the end, s; at last a weight of 0 is repeated, because
a best-effort reader may miss one."""

MOVED: Final = select_joints("arms,waist")
"""(29,) the joints that the robot's own controller lets others move."""


class Composer:
    """Makes the LowCmd and the Reference of a tick.

    Args:
        limits: of a command.
        gains: kp and kd in every phase but DAMP.
        damp_kd: kd in DAMP, N·m·s/rad.
        played: (29,) which joints play the motion, all if None; told in the Reference.
        commanded: (29,) which motors get commands, all if None; the slots of the others are all 0.

    Attributes:
        limits: as given; it counts what it has changed.
    """

    def __init__(
        self,
        limits: CommandLimits,
        gains: Gains,
        damp_kd: float,
        played: NDArray[np.bool_] | None = None,
        commanded: NDArray[np.bool_] | None = None,
    ) -> None:
        self.limits = limits
        self._damp_kd = damp_kd
        self._servo: Floats = np.stack(gains)
        self._wire = np.zeros((3, N_JOINTS), np.float32)
        self._asked = np.zeros((2, N_JOINTS))
        self._command, self._reference = LowCmd(), Reference()
        self._published = np.zeros(len(self._reference.target), np.float32)
        everything = np.ones(N_JOINTS, np.bool_)
        self._reference.played[()] = played_bits(everything if played is None else played)
        self._commanded = everything if commanded is None else commanded
        self._silent = np.flatnonzero(~self._commanded)

    def begin(self, q: NDArray[np.floating], mode_machine: int) -> None:
        """Enable the motors of a robot at the measured pose `q` (29,), rad."""
        self.limits.begin(q)
        command = self._command
        command.motor_mode = self._commanded.astype(np.uint8)
        command.mode_pr[()] = 0  # the other mode changes the meaning of ankle and waist joints
        command.mode_machine[()] = mode_machine
        command.kp[:], command.kd[:] = self._servo
        command.q[:] = q

    def damp(self) -> None:
        """Ask for no position, only for damping, from now on: the last target stays in place."""
        command = self._command
        command.kp[:] = command.dq[:] = command.tau[:] = 0.0
        command.kd[:] = self._damp_kd * self._commanded

    def compose(
        self,
        due: Target,
        commanded: Target,
        phase: Phase,
        tick: int,
        *,
        elapsed: float,
        ramped: float = 1.0,
        measured: Reading | None = None,
        age: float = 0.0,
    ) -> tuple[bytes, bytes]:
        """A sealed LowCmd and its Reference, as they go onto the wire.

        Args:
            due: the target at their publish time; published as Reference.
            commanded: the target of the LowCmd, which takes effect later; its torque is published
                in the Reference too.
            phase: of the session.
            tick: number of the Reference.
            elapsed: time since the command before, s.
            ramped: progress of the ramp, 0 to 1.
            measured: the newest LowState; None: the torque is not limited.
            age: of that when the command takes effect, s.

        Raises:
            SafetyError: a value of the command is not finite.
        """
        command, reference = self._command, self._reference
        if phase is not Phase.DAMP:  # what `damp` has set
            asked, wire = self._asked, self._wire
            asked[0], asked[1] = commanded.q, commanded.dq
            wire[:2], wire[2] = asked, commanded.tau
            self.limits.require_finite(wire)
            q_dq, tau = self.limits.apply(
                asked,
                commanded.tau,
                elapsed=elapsed,
                ramped=ramped,
                gains=self._servo,
                measured=measured,
                age=age,
            )
            (command.q[:], command.dq[:]), command.tau[:] = q_dq, tau
        reference.tick[()] = tick
        reference.phase[()] = phase
        reference.motion_time[()] = due.motion_time
        # Rounded as the LowCmd is: more digits mean nothing, and do not compress.
        np.concatenate(
            (
                due.q,
                due.dq,
                due.ddq,
                commanded.tau,
                due.root_pos,
                due.root_quat_wxyz,
                due.root_lin_vel,
                due.root_ang_vel,
            ),
            out=self._published,
            casting="same_kind",
        )
        reference.target[:] = self._published
        return self._seal(phase, tick), reference.tobytes()

    def _seal(self, phase: Phase, tick: int) -> bytes:
        """The LowCmd of a tick, with nothing in the slots of motors that get no command."""
        command = self._command
        if len(self._silent):
            for values in (command.q, command.dq, command.tau, command.kp, command.kd):
                values[self._silent] = 0.0
        return command.seal()


class ArmSdkComposer(Composer):
    """Makes commands for rt/arm_sdk: only arms and waist, and a weight.

    The weight rises from the first command on, and falls in DAMP; there, arms and waist keep gains
    and torque of the last target, without its velocity, while the controller takes them over.

    Args:
        limits, gains, played, commanded: as of `Composer`.
        period: ns between commands.
    """

    def __init__(
        self,
        limits: CommandLimits,
        gains: Gains,
        played: NDArray[np.bool_],
        commanded: NDArray[np.bool_],
        period: int,
    ) -> None:
        super().__init__(limits, gains, 0.0, played, commanded)
        self._sent, self._tick = 0.0, 0  # the weight of the last command; the tick after it
        self._next = 0.0
        self._period = period

    def damp(self) -> None:
        """Come to rest: gains and torque stay, see `_seal`."""
        self._command.dq[:] = 0.0

    def _seal(self, phase: Phase, tick: int) -> bytes:
        if tick != self._tick:  # what was made for the tick before has been sent
            self._sent, self._tick = self._next, tick
        self._next = _next_weight(self._sent, self._period, up=phase is not Phase.DAMP)
        self._command.weight[()] = self._next
        return super()._seal(phase, tick)


def hand_back_commands(command: bytes, period: int) -> Iterator[bytes]:
    """Sealed commands, `period` ns apart, that bring the weight of `command` to 0.

    Its targets, gains and torques stay, without velocity.
    """
    last = LowCmd()
    last.load(command)
    last.dq[:] = 0.0
    weight = float(last.weight)
    for _ in range(round(HAND_BACK_TIME * 1e9 / period) + 1):
        last.weight[()] = weight = _next_weight(weight, period, up=False)
        yield last.seal()


def _next_weight(weight: float, period: int, *, up: bool) -> float:
    """The weight of the command that is `period` ns later; of NaN it is 0."""
    step = period / 1e9 / WEIGHT_TIME
    return min(1.0, max(0.0, weight + (step if up else -step)))


class Prepared(NamedTuple):
    """A command, and what it was made of.

    Attributes:
        command: the LowCmd as it goes onto the wire.
        reference: its Reference, likewise.
        target: before feed-forward and limits.
        due: when it is published.
        measured: the newest LowState; None before the first.
        told: what the source tells of this command, and of those that it replaces.
    """

    command: bytes
    reference: bytes
    target: Target
    due: int
    measured: Reading | None
    told: tuple[bytes, ...] = ()


class NextCommand:
    """Makes commands, each some time before it is published.

    Args:
        schedule: the phases, and the target of each.
        composer: limits a command, and encodes it.
        feedforward: what a command carries beside the position.
        period: between commands.
        soft_start: length of damping before RAMP, so that the first commands are not stiff.
        clock: tells the time, ns; for the source.

    Attributes:
        composer, feedforward: as given.
        prepared: the newest command; None before the first.
        last: the newest target that was asked for.
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
        self.last = schedule.first.at_rest()
        self._schedule = schedule
        self._period = period
        self._soft_start = soft_start
        self._soft_until: int | None = None
        self._clock = clock
        self._told: tuple[bytes, ...] = ()
        self._sent = 0
        self._sent_for: int | None = None

    @property
    def phase(self) -> Phase:
        """As which commands are published: a soft start only damps."""
        return self._schedule.state.phase if self._soft_until is None else Phase.DAMP

    def begin(self, measured: Reading, support: str | None, model: str | None) -> None:
        """RAMP begins, of a robot that announces its support and model; None where it does not."""
        self.feedforward.begin(support, model)
        self._ramp_from(measured)
        if self._soft_start:
            self._soft_until = self._schedule.state.since + self._soft_start
            self.composer.damp()

    def _ramp_from(self, measured: Reading) -> None:
        self.composer.begin(measured.q, measured.mode_machine)
        self._schedule.begin_ramp(measured.q)
        self.feedforward.source.ramp_to(self._schedule.first)

    def continue_soft_start(self, deadline: int, measured: Reading | None) -> None:
        """Begin RAMP anew from the pose measured now, until the soft start, if any, is over."""
        if self._soft_until is None:
            return
        self._schedule.state = replace(self._schedule.state, since=deadline)
        if measured:
            self._ramp_from(measured)
        if deadline < self._soft_until:
            self.composer.damp()
            return
        self._soft_until = None
        _LOGGER.info("soft start: damped for %g s", self._soft_start / 1e9)

    def delay_soft_start(self, gap: int) -> None:
        """The soft start, if any, ends later by `gap`, in which nothing was sent."""
        if self._soft_until is not None:
            self._soft_until += gap

    def prepare(self, deadline: int, now: int, measured: Reading | None) -> None:
        """Make the command that is published at `deadline`."""
        schedule, feedforward = self._schedule, self.feedforward
        commanded = due = self.last = schedule.target(deadline, self.last)
        if measured and self.phase is not Phase.DAMP:
            if preview := round(feedforward.preview * 1e9):
                self.last = schedule.target_ahead(deadline + preview, due)
            age = (now - measured.received) / 1e9
            time = (deadline - schedule.delayed) / 1e9
            ramped = schedule.ramped(deadline)
            moment = Moment(
                self.phase, ramped, self.last, measured, age, time, self._sent, self._clock
            )
            commanded = feedforward.command(moment)
            # Of a command that is replaced before it is sent, it is told with the next one.
            if told := feedforward.source.told():
                self._told = (*self._told, told)
        self.compose(due, commanded, deadline, measured)

    def compose(
        self, due: Target, commanded: Target, deadline: int, measured: Reading | None
    ) -> None:
        """Limit and encode the target `commanded`, with `due` as the reference."""
        since = deadline - self._period if self._sent_for is None else self._sent_for
        command, reference = self.composer.compose(
            due,
            commanded,
            self.phase,
            self._sent,
            elapsed=(deadline - since) / 1e9,
            ramped=minimum_jerk(self._schedule.ramped(deadline))[0],
            measured=measured,
            age=(deadline - measured.received) / 1e9 if measured else 0.0,
        )
        self.prepared = Prepared(command, reference, due, deadline, measured, self._told)

    def sent(self) -> None:
        """The newest command has been sent."""
        self.composer.limits.sent()
        self._sent += 1
        self._told = ()
        if self.prepared:
            self._sent_for = self.prepared.due
