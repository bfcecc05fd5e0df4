"""A link that publishes recorded commands in place of the loop's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.control.commands import MAX_STEP_TIME
from g1stream.control.link import DdsLink
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import SafetyError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.types import Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.control.guard import Heartbeat
    from g1stream.dds.domain import Participant
    from g1stream.exact_replay.commands import RecordedCommands

__all__ = ["RecordedLink"]


class RecordedLink(DdsLink):
    """Publishes, during PLAY, the recorded command nearest in time, bit for bit.

    RAMP, HOLD, DAMP and the safety checks are the loop's. When the loop skips ticks, at most the
    commands of `MAX_STEP_TIME` are skipped with them, as of any motion.

    Args:
        participant: whose domain to use.
        recorded: the commands.
        heartbeat: of the guard process; None: there is none.
    """

    def __init__(
        self,
        participant: Participant,
        recorded: RecordedCommands,
        heartbeat: Heartbeat | None = None,
    ) -> None:
        super().__init__(participant, heartbeat)
        # A command is the nearest between the midpoints to its neighbours.
        self._until = (recorded.times[1:] + recorded.times[:-1]) / 2.0
        self._data = recorded.data
        self._max_step = recorded.velocity * MAX_STEP_TIME
        self._own, self._recorded, self._reference = LowCmd(), LowCmd(), Reference()
        #: The joint targets that were sent last, and whether they were recorded ones.
        self._last: NDArray[np.float32] | None = None
        self._replaying = False

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and its Reference, both with the publish time `stamp`, ns.

        Returns:
            When the LowCmd was written, ns of CLOCK_MONOTONIC.

        Raises:
            SafetyError: the recorded command is for another robot, or the target would jump
                between the loop's commands and recorded ones.
        """
        self._reference.load(reference)
        phase, sent = int(self._reference.phase), self._own
        self._own.load(command)
        if phase == Phase.PLAY:
            command, sent = self._recorded_at(float(self._reference.motion_time)), self._recorded
        if phase != Phase.DAMP:  # which commands no position, and must not fail
            self._require_no_jump(sent.q, phase == Phase.PLAY)
        return super().send(command, reference, stamp)

    def _recorded_at(self, motion_time: float) -> bytes:
        """The recorded command nearest to a time, s; also loaded into `_recorded`."""
        data = self._data[int(np.searchsorted(self._until, motion_time))]
        self._recorded.load(data)
        if self._own.mode_machine != self._recorded.mode_machine:
            raise SafetyError(
                f"The recorded commands are for mode_machine {self._recorded.mode_machine}, this "
                f"robot has {self._own.mode_machine}.",
                "Replay the reference instead: leave out --exact.",
            )
        return data

    def _require_no_jump(self, q: NDArray[np.float32], replaying: bool) -> None:
        """Check the transitions; steps between two recorded or two own commands are checked."""
        last, before = self._last, self._replaying
        self._last, self._replaying = q.copy(), replaying
        if last is None or before == replaying:
            return
        steps = np.abs(q - last)
        if (steps <= self._max_step).all():
            return
        joint = int(np.argmax(steps / self._max_step))
        raise SafetyError(
            f"{JOINT_NAMES[joint]} would jump by {steps[joint]:.3f} rad at the "
            f"{'begin' if replaying else 'end'} of the recorded commands.",
            "Replay the reference instead: leave out --exact. Or play the whole recording, with "
            "the joint limits (safety.position_margin) of the recording.",
        )
