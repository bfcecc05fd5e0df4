"""The command of the next deadline: the target of the schedule, feed-forward, limits.

Pure: times and measurements come in as arguments. All times are ns of one clock.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from g1stream.types import Phase

if TYPE_CHECKING:
    from g1stream.control.commands import Composer
    from g1stream.control.feedforward import FeedForward
    from g1stream.control.schedule import Schedule
    from g1stream.control.state_checks import Measured
    from g1stream.control.targets import Ramp, Target

__all__ = ["NextCommand", "Prepared"]

_LOGGER = logging.getLogger(__name__)


class Prepared(NamedTuple):
    """A command, and what it was made of.

    Attributes:
        command: the LowCmd as it goes onto the wire.
        reference: its Reference, likewise.
        target: before feed-forward and limits.
        due: when it is published.
        measured: the newest LowState; None before the first.
    """

    command: bytes
    reference: bytes
    target: Target
    due: int
    measured: Measured | None


class NextCommand:
    """Makes commands, each some time before it is published.

    Args:
        schedule: the phases, and the target of each.
        composer: limits a command, and encodes it.
        period: between commands.
        feedforward: what a command carries beside the position; the velocity alone if left out.
        soft_start: length of damping before RAMP, so that the first commands are not stiff.

    Attributes:
        feedforward: as given.
        limits: those of the composer.
        prepared: the newest command; None before the first.
        ramp: the way to the first frame; None until RAMP begins.
    """

    def __init__(
        self,
        schedule: Schedule,
        composer: Composer,
        *,
        period: int,
        feedforward: FeedForward | None = None,
        soft_start: int = 0,
    ) -> None:
        self.feedforward = feedforward
        self.limits = composer.limits
        self.prepared: Prepared | None = None
        self.ramp: Ramp | None = None
        self._schedule = schedule
        self._composer = composer
        self._period = period
        self._soft_start = soft_start
        self._soft_until: int | None = None
        self._sent = 0
        self._sent_for: int | None = None

    def begin(self, measured: Measured, support: str | None, model: str | None) -> None:
        """RAMP begins, of a robot that announces its support and model; None where it does not."""
        if self.feedforward:
            self.feedforward.begin(support, model)
        self._ramp_from(measured)
        if self._soft_start:
            self._soft_until = self._schedule.state.since + self._soft_start
            self.damp()

    def _ramp_from(self, measured: Measured) -> None:
        self._composer.begin(measured.q, measured.mode_machine)
        self.ramp = self._schedule.begin_ramp(measured.q)
        if self.feedforward:
            self.feedforward.ramp = self.ramp.length
            self.feedforward.ramp_to(self._schedule.first)

    def damp(self) -> None:
        """Commands only damp from now on."""
        self._composer.damp()

    def continue_soft_start(self, deadline: int, measured: Measured | None) -> None:
        """Begin RAMP anew from the pose measured now, until the soft start, if any, is over."""
        if self._soft_until is None:
            return
        self._schedule.state = replace(self._schedule.state, since=deadline)
        if measured:
            self._ramp_from(measured)
        if deadline < self._soft_until:
            self.damp()
            return
        self._soft_until = None
        _LOGGER.info("soft start: damped for %g s", self._soft_start / 1e9)

    def delay_soft_start(self, gap: int) -> None:
        """The soft start, if any, ends later by `gap`, in which nothing was sent."""
        if self._soft_until is not None:
            self._soft_until += gap

    def prepare(self, deadline: int, now: int, measured: Measured | None) -> None:
        """Make the command that is published at `deadline`."""
        schedule, feedforward = self._schedule, self.feedforward
        commanded = due = schedule.target(deadline)
        soft = schedule.state.phase is Phase.DAMP or self._soft_until is not None
        if feedforward and measured and not soft:
            preview = round(feedforward.preview * 1e9)
            effective = schedule.target_ahead(deadline + preview) if preview else due
            commanded = feedforward.command(
                schedule.state.phase,
                schedule.state.elapsed(deadline) / 1e9,
                effective,
                measured.imu,
                (now - measured.received) / 1e9,
            )
        self.compose(due, commanded, deadline, measured)

    def compose(
        self, due: Target, commanded: Target, deadline: int, measured: Measured | None
    ) -> None:
        """Limit and encode the target `commanded`, with `due` as the reference."""
        since = deadline - self._period if self._sent_for is None else self._sent_for
        command, reference = self._composer.compose(
            due,
            commanded,
            self._schedule.state.phase if self._soft_until is None else Phase.DAMP,
            self._sent,
            elapsed=(deadline - since) / 1e9,
            ramped=self._schedule.ramped(deadline),
            measured=measured,
            age=(deadline - measured.received) / 1e9 if measured else 0.0,
        )
        self.prepared = Prepared(command, reference, due, deadline, measured)

    def sent(self) -> None:
        """The newest command has been sent."""
        self._composer.sent()
        self._sent += 1
        if self.prepared:
            self._sent_for = self.prepared.due
