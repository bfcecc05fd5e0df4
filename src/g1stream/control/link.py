"""What the loop needs of the wire, and the wire itself."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

from g1stream.dds.domain import OBSERVER, support_announced
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import Log
from g1stream.dds.ticks import TickGaps
from g1stream.dds.topics import LOG, LOWCMD, LOWSTATE, REFERENCE

if TYPE_CHECKING:
    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import LowState
    from g1stream.dds.topics import Topic

__all__ = ["DdsLink", "Link"]

#: LowStates that may wait while the loop is not scheduled: 64 ms at 1 kHz, none of them uncounted.
_STATE_DEPTH: Final = 64


class Link(Protocol):
    """Commands out, states back. No call waits."""

    def listeners(self) -> int:
        """How many readers of LowCmd are matched that may obey it."""

    def rivals(self) -> list[str]:
        """Who else writes LowCmd, named as well as can be."""

    def support(self) -> str | None:
        """How the bridge says that it holds the robot; None where it does not say."""

    def receive(self, state: LowState) -> bool:
        """Load the newest LowState since the last call; False where none came."""

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and the Reference beside it, both with the publish time `stamp`, ns.

        Returns:
            When the LowCmd was out, ns of CLOCK_MONOTONIC.
        """

    def tell(self, level: int, text: str) -> None:
        """Publish an event: level 2 info, 3 warning, 4 error."""


class DdsLink:
    """The loop's end of the wire; counts every LowState, though the loop looks at the newest."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._commands = RawWriter(participant, LOWCMD)
        self._references = RawWriter(participant, REFERENCE)
        self._log = RawWriter(participant, LOG, depth=100)
        self._states = RawReader(participant, LOWSTATE, depth=_STATE_DEPTH)
        self._gaps = TickGaps()
        self._tick_at = slice(*_bytes_of(LOWSTATE, "tick"))
        self._others = RawReader(participant, LOWCMD, ignore_own=True, user_data=OBSERVER)
        self._message = Log()
        self._message.name = "stream"

    def listeners(self) -> int:
        """How many readers of LowCmd are matched that may obey it: a recorder does not."""
        matched = self._commands.matched
        if not matched:
            return 0
        readers = self._participant.readers(LOWCMD.name)
        return max(0, matched - sum(reader.user_data == OBSERVER for reader in readers))

    def rivals(self) -> list[str]:
        """Who else writes LowCmd."""
        if not self._others.matched:
            return []
        named = [str(writer) for writer in self._participant.writers(LOWCMD.name)]
        return named or ["a participant that does not tell its name"]

    def support(self) -> str | None:
        """How the bridge says that it holds the robot; None where it does not say."""
        return support_announced(self._participant.writers(LOWSTATE.name))

    def receive(self, state: LowState) -> bool:
        """Load the newest LowState since the last call; False where none came."""
        samples = self._states.take(_STATE_DEPTH)
        if not samples:
            return False
        for sample in samples:
            self._gaps.add(int.from_bytes(sample.data[self._tick_at], "little"))
        state.load(samples[-1].data)
        return True

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and the Reference beside it, both with the publish time `stamp`, ns.

        Returns:
            When the LowCmd was out, ns of CLOCK_MONOTONIC.
        """
        self._commands.write(command, stamp)
        out = time.monotonic_ns()
        self._references.write(reference, stamp)
        return out

    def counts(self) -> dict[str, int | None]:
        """What was lost on the wire and what was not, as JSON values.

        `states_missed` is told by the ticks of those that came, and None where the publisher does
        not count; `states_lost` is what DDS itself knows of; `commands_dropped` could not be
        written at once.
        """
        return {
            "states_received": self._gaps.received,
            "states_missed": self._gaps.missed,
            "states_lost": self._states.lost,
            "states_malformed": self._states.malformed,
            "state_restarts": self._gaps.restarts,
            "commands_dropped": self._commands.dropped,
        }

    def tell(self, level: int, text: str) -> None:
        """Publish an event: level 2 info, 3 warning, 4 error."""
        self._message.level[()] = level
        self._message.text = text
        self._log.write(self._message.tobytes(), time.time_ns())


def _bytes_of(topic: Topic, path: str) -> tuple[int, int]:
    """Where a scalar field begins and ends in a sample, CDR header included."""
    field = Layout.of(topic.message.idl_type)[path]
    start = len(CDR_HEADER) + int(field.offsets)
    return start, start + field.dtype.itemsize
