"""What the loop needs of the wire: the interface, and its implementation over DDS."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

from g1stream.control.guard import Takeover, count_subscribers
from g1stream.dds.domain import OBSERVER, robot_announced, support_announced
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE, Topic
from g1stream.dds.ticks import TickGaps

if TYPE_CHECKING:
    from g1stream.control.guard import Heartbeat
    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import LowState

__all__ = ["DdsLink", "Link", "OtherPublishers"]

#: LowStates that are queued while the loop is not scheduled: 64 ms at 1 kHz without a loss.
_STATE_DEPTH: Final = 64
#: How often the loop looks for other publishers, ns.
_PERIOD: Final = 100_000_000
#: Publishers of LowState that were heard in this time publish at once, ns.
_HEARD: Final = 100_000_000


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
        """Names of the publishers of LowState, if several publish at once."""

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and its Reference, both with the publish time `stamp`, ns.

        Returns:
            When the LowCmd was written, ns of CLOCK_MONOTONIC.
        """

    def unguarded(self) -> str:
        """Why the guard process could not damp the robot, or "" if it could or there is none."""

    def replaced(self) -> str:
        """Why the guard process damps the robot in our place, or ""."""


class DdsLink:
    """The link over DDS. Every LowState is counted, the newest one is used.

    Recorders and other observers are no subscribers.

    Args:
        participant: whose domain to use.
        heartbeat: of the guard process; None: there is none.
        topic: of the commands: LOWCMD, or ARM_SDK.
    """

    def __init__(
        self,
        participant: Participant,
        heartbeat: Heartbeat | None = None,
        topic: Topic = LOWCMD,
    ) -> None:
        self._participant = participant
        self._heartbeat = heartbeat
        self._topic = topic
        self._commands = RawWriter(participant, topic)
        self._references = RawWriter(participant, REFERENCE)
        self._states = RawReader(participant, LOWSTATE, depth=_STATE_DEPTH)
        self._others = RawReader(participant, topic, ignore_own=True, user_data=OBSERVER)
        self._gaps = TickGaps()
        self._heard: dict[int, int] = {}  # publisher of LowState -> when it was heard last, ns
        self._own_bridge = False
        self._matches: tuple[int, int] | None = (0, 0)
        self._other_names: list[str] = []
        tick = Layout.of(LOWSTATE.idl_type)["tick"]
        start = len(CDR_HEADER) + int(tick.offsets)
        self._tick_bytes = slice(start, start + tick.dtype.itemsize)

    def subscribers(self) -> int:
        return count_subscribers(self._participant, self._commands)

    def other_publishers(self) -> list[str]:
        # Asking for names takes a fraction of a tick, so it is done only when a writer has come or
        # gone since.
        matches = self._others.matches
        if matches != self._matches:
            self._matches = matches
            participant = self._participant
            unknown = matches[0] - len(participant.writers(self._topic.name))
            if unknown > 0:  # not announced yet: ask again
                self._matches = None
            self._other_names = [
                *(participant.owner(one) for one in participant.commanders(self._topic.name)),
                *["an unnamed participant"] * max(0, unknown),
            ]
        return self._other_names

    def support(self) -> str | None:
        support = support_announced(self._participant.writers(LOWSTATE.name))
        self._own_bridge = self._own_bridge or support is not None
        return support

    def model(self) -> str | None:
        return robot_announced(self._participant.writers(LOWSTATE.name))

    def receive(self, state: LowState) -> int | None:
        samples = self._states.take(_STATE_DEPTH)
        if not samples:
            return None
        for sample in samples:
            self._gaps.add(int.from_bytes(sample.data[self._tick_bytes], "little"))
            self._heard[sample.sample_info.publication_handle] = time.monotonic_ns()
        state.load(samples[-1].data)
        return int(samples[-1].sample_info.publication_handle)

    def state_publishers(self) -> list[str]:
        """Names of the publishers of LowState, if several have published in the last 0.1 s.

        One that has died does not count, though DDS may show it for a while.
        """
        since = time.monotonic_ns() - _HEARD
        self._heard = {one: last for one, last in self._heard.items() if last >= since}
        if len(self._heard) < 2:
            return []
        named = [self._participant.owner(one) for one in self._participant.writers(LOWSTATE.name)]
        return named or ["unnamed participants"]

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """As of `Link`; where the guard process has taken over, its last command is sent."""
        if self._heartbeat:
            self._heartbeat.beat(command, time.monotonic_ns())
        replacement = self._replacement()
        self._commands.write(replacement or command, stamp)
        written = time.monotonic_ns()
        if (newer := self._replacement()) != replacement:
            self._commands.write(newer)  # the guard went on during the write
        self._references.write(reference, stamp)
        return written

    def _replacement(self) -> bytes:
        """What the guard process sends in our place; empty as long as it does not."""
        return self._heartbeat.replacement if self._heartbeat else b""

    def unguarded(self) -> str:
        if self._heartbeat is None or self._heartbeat.subscribers:
            return ""
        return f"the guard process has found no subscriber on {self._topic.name}"

    def replaced(self) -> str:
        why = self._heartbeat.takeover if self._heartbeat else Takeover.NONE
        return f"the guard process damps the robot: this process {why}" if why else ""

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
