"""A link that publishes commands of an earlier session in place of the loop's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from g1stream.control.link import DdsLink
from g1stream.control.phases import Phase
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import SafetyError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.dds.domain import Participant

__all__ = ["RecordedLink"]


class RecordedLink(DdsLink):
    """Publishes, while the motion is played, the recorded command nearest in time, bit for bit.

    Everything else goes as the loop has it: the ramp to the first pose, HOLD, DAMP, and the
    watchdogs.

    Args:
        participant: whose domain to be in.
        times: (N,) when in the motion each command is due, s, rising.
        commands: (N) LowCmds as they were on the wire, CDR header included.
    """

    def __init__(
        self, participant: Participant, times: NDArray[np.float64], commands: Sequence[bytes]
    ) -> None:
        super().__init__(participant)
        # A command is the nearest from half way to the one before to half way to the next.
        self._until = (times[1:] + times[:-1]) / 2.0
        self._recorded = commands
        self._own, self._other, self._asked = LowCmd(), LowCmd(), Reference()

    def send(self, command: bytes, reference: bytes, stamp: int) -> None:
        """Publish a LowCmd and the Reference beside it with the same publish time, ns.

        Raises:
            SafetyError: the recorded command is for another robot than the one that is there.
        """
        self._asked.load(reference)
        if self._asked.phase == Phase.PLAY:
            command = self._in_place_of(command, float(self._asked.motion_time))
        super().send(command, reference, stamp)

    def _in_place_of(self, command: bytes, motion_time: float) -> bytes:
        recorded = self._recorded[int(np.searchsorted(self._until, motion_time))]
        self._own.load(command)
        self._other.load(recorded)
        if self._own.mode_machine != self._other.mode_machine:
            raise SafetyError(
                f"The recorded commands are for mode_machine {self._other.mode_machine}, and this "
                f"robot says {self._own.mode_machine}.",
                "Replay the reference instead: leave out --exact.",
            )
        return recorded
