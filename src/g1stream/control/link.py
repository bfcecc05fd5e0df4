"""What the loop needs of the wire: the interface, and its implementation over DDS."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

from g1stream.dds.domain import OBSERVER, support_announced
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.ticks import TickGaps
from g1stream.dds.topics import LOWCMD, LOWSTATE, REFERENCE

if TYPE_CHECKING:
    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import LowState

__all__ = ["DdsLink", "Link"]

#: LowStates that are queued while the loop is not scheduled: 64 ms at 1 kHz without a loss.
_STATE_DEPTH: Final = 64


class Link(Protocol):
    """Commands out, states in. No call blocks."""

    def subscribers(self) -> int:
        """Number of matched subscribers of LowCmd that may act on it."""

    def other_publishers(self) -> list[str]:
        """Names of other publishers of LowCmd."""

    def support(self) -> str | None:
        """How the bridge announces to hold the robot; None if it does not."""

    def receive(self, state: LowState) -> bool:
        """Load the newest LowState since the last call; False if there is none."""

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and its Reference, both with the publish time `stamp`, ns.

        Returns:
            When the LowCmd was written, ns of CLOCK_MONOTONIC.
        """


class DdsLink:
    """The link over DDS. Every LowState is counted, the newest one is used."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._commands = RawWriter(participant, LOWCMD)
        self._references = RawWriter(participant, REFERENCE)
        self._states = RawReader(participant, LOWSTATE, depth=_STATE_DEPTH)
        self._others = RawReader(participant, LOWCMD, ignore_own=True, user_data=OBSERVER)
        self._gaps = TickGaps()
        self._own_bridge = False
        tick = Layout.of(LOWSTATE.message.idl_type)["tick"]
        start = len(CDR_HEADER) + int(tick.offsets)
        self._tick_bytes = slice(start, start + tick.dtype.itemsize)

    def subscribers(self) -> int:
        """Number of matched subscribers of LowCmd, without recorders and other observers."""
        matched = self._commands.matched
        if not matched:
            return 0
        readers = self._participant.readers(LOWCMD.name)
        return max(0, matched - sum(reader.user_data == OBSERVER for reader in readers))

    def other_publishers(self) -> list[str]:
        """Names of other publishers of LowCmd."""
        if not self._others.matched:
            return []
        named = [self._participant.owner(one) for one in self._participant.writers(LOWCMD.name)]
        return named or ["an unnamed participant"]

    def support(self) -> str | None:
        """How the bridge announces to hold the robot; None if it does not."""
        support = support_announced(self._participant.writers(LOWSTATE.name))
        self._own_bridge = self._own_bridge or support is not None
        return support

    def receive(self, state: LowState) -> bool:
        """Load the newest LowState since the last call; False if there is none."""
        samples = self._states.take(_STATE_DEPTH)
        if not samples:
            return False
        for sample in samples:
            self._gaps.add(int.from_bytes(sample.data[self._tick_bytes], "little"))
        state.load(samples[-1].data)
        return True

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and its Reference, both with the publish time `stamp`, ns.

        Returns:
            When the LowCmd was written, ns of CLOCK_MONOTONIC.
        """
        self._commands.write(command, stamp)
        written = time.monotonic_ns()
        self._references.write(reference, stamp)
        return written

    def counts(self) -> dict[str, int | None]:
        """What was received and lost: the fields of `StreamSummary` with these names."""
        self.support()
        return {
            "states_received": self._gaps.received,
            "states_lost": self._gaps.missed if self._own_bridge else None,
            "tick_jumps": self._gaps.jumps,
            "dds_lost": self._states.lost,
            "states_malformed": self._states.malformed,
            "state_restarts": self._gaps.restarts,
            "commands_dropped": self._commands.dropped,
        }
