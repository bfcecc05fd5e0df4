"""A link that publishes commands of an earlier session in place of the loop's own."""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.control.link import DdsLink
from g1stream.dds.messages import LowCmd, Reference
from g1stream.errors import SafetyError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.dds.domain import Participant

__all__ = ["LEAP_TIME", "PackedCommands", "RecordedLink"]

LEAP_TIME: Final = 0.02
"""A target that moves on at once by more than its joint can in this time leaps, s."""


class RecordedLink(DdsLink):
    """Publishes, while the motion is played, the recorded command nearest in time, bit for bit.

    Everything else goes as the loop has it: the ramp to the first pose, HOLD, DAMP, and the
    watchdogs. Where the loop skips ticks, so are the commands that were due meanwhile, and the next
    may be further away than `LEAP_TIME` allows: as for any motion, safety.state_timeout bounds for
    how long the loop may stand still. The commands were looked at beforehand, so that no joint is
    asked to go further than it can in the time that has passed; to let go of a robot that moves
    would be worse.

    Args:
        participant: whose domain to be in.
        times: (N,) when in the motion each command is due, s, rising.
        commands: (N) LowCmds, each of which the robot can reach from the one before.
        velocity: (29,) what the joints can do, rad/s.
    """

    def __init__(
        self,
        participant: Participant,
        times: NDArray[np.float64],
        commands: PackedCommands,
        velocity: NDArray[np.float64],
    ) -> None:
        super().__init__(participant)
        # A command is the nearest from half way to the one before to half way to the next.
        self._until = (times[1:] + times[:-1]) / 2.0
        self._recorded = commands
        self._leap = velocity * LEAP_TIME
        self._own, self._other, self._asked = LowCmd(), LowCmd(), Reference()
        #: The joint targets that went out last, and whether they were recorded ones.
        self._last: NDArray[np.float32] | None = None
        self._replaying = False

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and the Reference beside it with the same publish time, ns.

        Returns:
            When the LowCmd was out, ns of CLOCK_MONOTONIC.

        Raises:
            SafetyError: the recorded command is for another robot than the one that is there, or
                the robot would leap into what is recorded, or out of it.
        """
        self._asked.load(reference)
        phase, going_out = int(self._asked.phase), self._own
        self._own.load(command)
        if phase == Phase.PLAY:
            command, going_out = self._in_place_of(float(self._asked.motion_time)), self._other
        if phase != Phase.DAMP:  # which holds no joint anywhere, and must not fail
            self._require_no_leap(going_out.q, phase == Phase.PLAY)
        return super().send(command, reference, stamp)

    def _in_place_of(self, motion_time: float) -> bytes:
        """What was recorded instead of the loop's own command; is loaded into `_other`."""
        recorded = self._recorded[int(np.searchsorted(self._until, motion_time))]
        self._other.load(recorded)
        if self._own.mode_machine != self._other.mode_machine:
            raise SafetyError(
                f"The recorded commands are for mode_machine {self._other.mode_machine}, and this "
                f"robot says {self._own.mode_machine}.",
                "Replay the reference instead: leave out --exact.",
            )
        return recorded

    def _require_no_leap(self, q: NDArray[np.float32], replaying: bool) -> None:
        """Between the loop's own commands and recorded ones: each by itself has been looked at."""
        last, before = self._last, self._replaying
        self._last, self._replaying = q.copy(), replaying
        if last is None or before == replaying:
            return
        steps = np.abs(q - last)
        if (steps <= self._leap).all():
            return
        joint = int(np.argmax(steps / self._leap))
        raise SafetyError(
            f"{JOINT_NAMES[joint]} would leap by {steps[joint]:.3f} rad "
            f"{'into' if replaying else 'out of'} the recorded commands.",
            "Replay the reference instead: leave out --exact. Or play all of what was recorded, "
            "with the joint limits (safety.position_margin) that it was recorded with.",
        )


class _Block(NamedTuple):
    """Commands of one time, and which of their bytes differ."""

    first: NDArray[np.uint8]
    differing: NDArray[np.intp]
    values: NDArray[np.uint8]


class PackedCommands:
    """LowCmds in order, bit for bit, in a third of their size.

    Most of a LowCmd never changes: gains, modes, motors that a G1 has not. Of each block, the first
    command is kept, and of the others the bytes in which any differs. Nothing is read from a file
    or unpacked at length when a command is due.
    """

    def __init__(self) -> None:
        self._blocks: list[_Block] = []
        self._starts: list[int] = []
        self._n = 0

    def add(self, commands: Sequence[bytes]) -> None:
        """Add a block of commands, all of one size; some hundred are worth while."""
        if not commands:
            return
        rows = np.frombuffer(b"".join(commands), np.uint8).reshape(len(commands), -1)
        differing = np.flatnonzero((rows != rows[0]).any(axis=0))
        self._blocks.append(_Block(rows[0].copy(), differing, rows[:, differing]))
        self._starts.append(self._n)
        self._n += len(commands)

    def __len__(self) -> int:
        return self._n

    def __getitem__(self, i: int) -> bytes:
        if not 0 <= i < self._n:
            raise IndexError(i)
        number = bisect_right(self._starts, i) - 1
        block = self._blocks[number]
        row = block.first.copy()
        row[block.differing] = block.values[i - self._starts[number]]
        return bytes(row)
