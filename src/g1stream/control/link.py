"""What the loop needs of the wire: the interface, and its implementation over DDS."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

from g1stream.control.guard import Takeover, count_subscribers
from g1stream.dds.domain import IDLE, OBSERVER, PUBLISHING, AnnouncedBridge
from g1stream.dds.endpoints import PublishersByTurns, RawReader, RawWriter
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import ARM_SDK, LOWCMD, LOWSTATE, REFERENCE, Topic
from g1stream.dds.ticks import TickGaps

if TYPE_CHECKING:
    from g1stream.control.guard import Heartbeat
    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import LowState

__all__ = ["END_OTHER", "DdsLink", "Link", "OtherPublishers"]

#: LowStates that are queued while the loop is not scheduled: 64 ms at 1 kHz without a loss.
_STATE_DEPTH: Final = 64
#: Messages beside one command.
_TOLD_DEPTH: Final = 8
#: How long a second publisher of LowState is listened for, s. One that was killed is announced for
#: some time, and publishes nothing.
_SECOND_PUBLISHER: Final = 2.0
#: How often the loop looks for other publishers, ns.
_PERIOD: Final = 100_000_000


class Link(Protocol):
    """Commands out, states in. No call blocks."""

    def subscribers(self) -> int:
        """Number of matched subscribers of LowCmd that may act on it."""

    def other_publishers(self) -> list[str]:
        """Names of other publishers of LowCmd."""

    def support(self) -> str | None:
        """How the bridge announces to hold the robot; None if it does not."""

    def model(self) -> str | None:
        """The name of the robot that the bridge announces to simulate; None if it does not."""

    def receive(self, state: LowState) -> int | None:
        """Load the newest LowState since the last call.

        Returns:
            The identity of its publisher; None if there is no LowState.
        """

    def state_publishers(self) -> list[str]:
        """Names of the publishers of LowState, if several publish by turns."""

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and its Reference, both with the publish time `stamp`, ns.

        Returns:
            When the LowCmd was written, ns of CLOCK_MONOTONIC; 0: it could not be.
        """

    def tell(self, topic: Topic, data: bytes, stamp: int) -> None:
        """Publish what a source tells of the LowCmd that was sent last, with its publish time."""

    def unready(self) -> str:
        """Why the first command has to wait, or "": for the guard process or for LowStates."""

    def replaced(self) -> str:
        """Why the guard process damps the robot in our place, or ""."""


class DdsLink:
    """The link over DDS. Every LowState is counted, the newest one is used.

    Recorders and other observers are no subscribers.

    Args:
        participant: whose domain to use.
        heartbeat: of the guard process; None: there is none.
        topic: of the commands: LOWCMD, or ARM_SDK.
        told: topic of what a source tells of commands; None: it tells nothing.
    """

    def __init__(
        self,
        participant: Participant,
        heartbeat: Heartbeat | None = None,
        topic: Topic = LOWCMD,
        told: Topic | None = None,
    ) -> None:
        self._participant = participant
        self._heartbeat = heartbeat
        self._topic = topic
        self._commands = RawWriter(participant, topic, user_data=IDLE)
        self._idle = True
        self._references = RawWriter(participant, REFERENCE)
        self._told = RawWriter(participant, told, depth=_TOLD_DEPTH) if told else None
        self._states = RawReader(participant, LOWSTATE, depth=_STATE_DEPTH)
        self._others = RawReader(participant, topic, ignore_own=True, user_data=OBSERVER)
        self._gaps = TickGaps()
        self._state_turns = PublishersByTurns()
        self._several = False
        self._since = time.monotonic()
        self._bridge: AnnouncedBridge | None = None
        self._published: set[int] = set()  # publishers of commands that were heard
        self._known: tuple[tuple[int, int], int] | None = ((0, 0), 0)
        self._other_names: list[str] = []
        tick = Layout.of(LOWSTATE.idl_type)["tick"]
        start = len(CDR_HEADER) + int(tick.offsets)
        self._tick_bytes = slice(start, start + tick.dtype.itemsize)

    def subscribers(self) -> int:
        return count_subscribers(self._participant, self._commands)

    def other_publishers(self) -> list[str]:
        # Asking for names takes a fraction of a tick, so it is done only when a writer has come,
        # gone or begun to publish since: what one announces is not believed of one that was heard.
        samples = self._others.take()
        self._published.update(one.sample_info.publication_handle for one in samples)
        known = self._others.matches, len(self._published)
        if known != self._known:
            participant = self._participant
            writers = participant.writers(self._topic.name)
            unknown = known[0][0] - len(writers)
            self._known = None if unknown > 0 else known  # not announced yet: ask again
            self._other_names = [
                *(
                    participant.owner(one)
                    for one in writers
                    if not one.idle or one.handle in self._published
                ),
                *["an unnamed participant"] * unknown,
            ]
        return self._other_names

    def support(self) -> str | None:
        bridge = self._announced()
        return bridge.support if bridge else None

    def model(self) -> str | None:
        bridge = self._announced()
        return bridge.robot or None if bridge else None

    def _announced(self) -> AnnouncedBridge | None:
        bridge = AnnouncedBridge.by(self._participant.writers(LOWSTATE.name))
        self._bridge = bridge or self._bridge
        return bridge

    def receive(self, state: LowState) -> int | None:
        samples = self._states.take(_STATE_DEPTH)
        if not samples:
            return None
        for sample in samples:
            self._gaps.add(int.from_bytes(sample.data[self._tick_bytes], "little"))
            if self._state_turns.hear(sample.sample_info.publication_handle):
                self._several = True
        state.load(samples[-1].data)
        state.published, state.received = samples[-1].publish_time, time.time_ns()
        return int(samples[-1].sample_info.publication_handle)

    def state_publishers(self) -> list[str]:
        if not self._several:
            return []
        named = [self._participant.owner(one) for one in self._participant.writers(LOWSTATE.name)]
        return named or ["unnamed participants"]

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """As of `Link`; where the guard process has taken over, its last command is sent."""
        heartbeat = self._heartbeat
        if heartbeat is None:
            written = self._write(command, stamp)
        else:
            heartbeat.begin_write(command, time.monotonic_ns())
            replacement, written = heartbeat.replacement, 0
            try:
                written = self._write(replacement or command, stamp)
                if (newer := heartbeat.replacement) != replacement:
                    self._commands.write(newer)  # the guard took over during the write
            finally:
                heartbeat.end_write(written)
        self._references.write(reference, stamp)
        return written

    def tell(self, topic: Topic, data: bytes, stamp: int) -> None:
        if self._told:
            self._told.write(data, stamp)

    def _write(self, command: bytes, stamp: int) -> int:
        if not self._commands.write(command, stamp):
            return 0
        written = time.monotonic_ns()
        if self._idle:
            self._idle = False
            self._commands.announce(PUBLISHING)
        return written

    def unready(self) -> str:
        if self._heartbeat and not self._heartbeat.subscribers:
            return f"the guard process has found no subscriber on {self._topic.name}"
        several = self._states.matched > 1
        if several and time.monotonic() < self._since + _SECOND_PUBLISHER:
            return "there are several publishers of LowState, of which one may be silent"
        return ""

    def replaced(self) -> str:
        why = self._heartbeat.takeover if self._heartbeat else Takeover.NONE
        return f"the guard process damps the robot: this process {why}" if why else ""

    def counts(self) -> dict[str, int | None]:
        """What was received and lost: the fields of `StreamSummary` with these names."""
        bridge = self._announced() or self._bridge
        return {
            "states_received": self._gaps.received,
            "states_lost": self._gaps.missed(bridge.tick_step) if bridge else None,
            "tick_jumps": self._gaps.jumps,
            "dds_lost": self._states.lost,
            "states_malformed": self._states.malformed,
            "state_restarts": self._gaps.restarts,
            "commands_dropped": self._commands.dropped,
        }


END_OTHER: Final = {
    LOWCMD: "Stop it; `g1stream robot release` releases the robot's own controller.",
    ARM_SDK: "Stop it: one program at a time can move the arms.",
}
"""By topic of commands, what to do about another publisher. The robot's own controller carries it
while a stream has its arms."""


class OtherPublishers:
    """Looks for other publishers of LowCmd, and for several of LowState.

    Args:
        link: the wire.
        allow_second_writer: whether there may be another publisher of commands.
        topic: of the commands.
    """

    def __init__(self, link: Link, *, allow_second_writer: bool, topic: Topic = LOWCMD) -> None:
        self._link, self._topic = link, topic
        self._allow_second_writer = allow_second_writer
        self._next_command_check = self._next_state_check = 0

    def stop_reason(self, now: int, *, waiting: bool) -> str:
        """Who else publishes at `now`, ns, or "".

        Args:
            now: time, ns.
            waiting: for the first command; then publishers of LowCmd are looked for at every call.
        """
        if now >= self._next_state_check:
            self._next_state_check = now + _PERIOD
            if several := self.of_state():
                return several
        if self._allow_second_writer or now < self._next_command_check:
            return ""
        if not waiting:
            self._next_command_check = now + _PERIOD
        others = self._link.other_publishers()
        return f"another publisher on {self._topic.name}: {', '.join(others)}" if others else ""

    def of_state(self) -> str:
        """The publishers of LowState, if several publish at once, or ""."""
        names = self._link.state_publishers()
        return f"more than one publisher on {LOWSTATE.name}: {', '.join(names)}" if names else ""
