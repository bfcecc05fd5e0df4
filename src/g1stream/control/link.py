"""What the loop needs of the wire, and the wire itself."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol

from g1stream.dds.messages import Log
from g1stream.dds.raw import RawReader, RawWriter
from g1stream.dds.topics import LOG, LOWCMD, LOWSTATE, REFERENCE

if TYPE_CHECKING:
    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import LowState

__all__ = ["DdsLink", "Link"]


class Link(Protocol):
    """Commands out, states back. No call waits."""

    def listeners(self) -> int:
        """How many readers of LowCmd are matched."""

    def rivals(self) -> list[str]:
        """Who else writes LowCmd, named as well as can be."""

    def receive(self, state: LowState) -> bool:
        """Load the newest LowState since the last call; False where none came."""

    def send(self, command: bytes, reference: bytes, stamp: int) -> None:
        """Publish a LowCmd and the Reference beside it, both with the publish time `stamp`, ns."""

    def tell(self, level: int, text: str) -> None:
        """Publish an event: level 2 info, 3 warning, 4 error."""


class DdsLink:
    """The loop's end of the wire."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._commands = RawWriter(participant, LOWCMD)
        self._references = RawWriter(participant, REFERENCE)
        self._log = RawWriter(participant, LOG, depth=100)
        self._states = RawReader(participant, LOWSTATE)
        self._others = RawReader(participant, LOWCMD, ignore_own=True)
        self._message = Log()
        self._message.name = "stream"

    def listeners(self) -> int:
        """How many readers of LowCmd are matched."""
        return self._commands.matched

    def rivals(self) -> list[str]:
        """Who else writes LowCmd."""
        if not self._others.matched:
            return []
        named = [str(writer) for writer in self._participant.writers(LOWCMD.name)]
        return named or ["a participant that does not tell its name"]

    def receive(self, state: LowState) -> bool:
        """Load the newest LowState since the last call; False where none came."""
        sample = self._states.take_latest()
        if sample is None:
            return False
        state.load(sample.data)
        return True

    def send(self, command: bytes, reference: bytes, stamp: int) -> None:
        """Publish a LowCmd and the Reference beside it with the same publish time, ns."""
        self._commands.write(command, stamp)
        self._references.write(reference, stamp)

    @property
    def dropped(self) -> int:
        """Commands that could not be written at once."""
        return self._commands.dropped

    def tell(self, level: int, text: str) -> None:
        """Publish an event: level 2 info, 3 warning, 4 error."""
        self._message.level[()] = level
        self._message.text = text
        self._log.write(self._message.tobytes(), time.time_ns())
