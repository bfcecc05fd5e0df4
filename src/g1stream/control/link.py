"""The link between loop and robot: its interface, and the implementation over DDS."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

from g1stream.control.guard import Takeover
from g1stream.control.stop import Stop
from g1stream.dds.discovery import IDLE, OBSERVER, PUBLISHING, AnnouncedBridge
from g1stream.dds.endpoints import PublishersByTurns, RawReader, RawWriter
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import LOWSTATE, POLICY, REFERENCE, Topic
from g1stream.dds.ticks import TickGaps

if TYPE_CHECKING:
    from g1stream.control.guard import Heartbeat
    from g1stream.control.receiver import Receiver
    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import LowState

__all__ = ["DdsLink", "Link", "OtherPublishers"]

#: LowStates that are queued while the loop is not scheduled; 64 ms at 1 kHz without a loss.
_STATE_DEPTH: Final = 64
#: Steps of a policy with one command.
_STEPS_DEPTH: Final = 8
#: Time in which a second publisher of LowState may prove to be silent, s. DDS announces a killed
#: publisher for some time, although it publishes nothing.
_SECOND_PUBLISHER: Final = 2.0
#: Interval at which the loop checks for other publishers, ns.
_PERIOD: Final = 100_000_000


class Link(Protocol):
    """Interface that publishes commands and receives states; no call blocks."""

    def other_publishers(self) -> list[str]:
        """Names of other publishers of LowCmd."""

    def announced(self) -> tuple[str | None, str | None]:
        """Support and name of the robot as the bridge announces them; None if it does not."""

    def receive(self, state: LowState) -> int | None:
        """Load the newest LowState since the last call.

        Returns:
            The identity of its publisher; None without a new LowState.
        """

    def state_publishers(self) -> list[str]:
        """Names of the publishers of LowState, if several publish; otherwise empty."""

    def send(self, command: bytes, reference: bytes, stamp: int) -> int:
        """Publish a LowCmd and its Reference, both with the publish time `stamp`, ns.

        Returns:
            When the LowCmd was written, ns of CLOCK_MONOTONIC; 0 if the write failed.
        """

    def send_step(self, data: bytes, stamp: int) -> None:
        """Publish a step of a policy, with the publish time of the last LowCmd."""

    def unready(self) -> str:
        """Why the first command has to wait for a subscriber, guard or LowStates, or ""."""

    def replaced(self) -> str:
        """Why the guard process commands the robot instead of this process, or ""."""


class DdsLink:
    """The link over DDS. It counts every LowState and uses the newest one.

    Recorders and other observers do not count as subscribers.

    Args:
        participant: the DDS participant.
        heartbeat: heartbeat of the guard process; None without a guard.
        receiver: the receiver of the commands.
        steps: also publish the steps of a policy.
    """

    def __init__(
        self,
        participant: Participant,
        heartbeat: Heartbeat | None,
        receiver: Receiver,
        steps: bool = False,
    ) -> None:
        self._participant = participant
        self._heartbeat = heartbeat
        self._receiver, self._topic = receiver, receiver.topic
        self._commands = RawWriter(participant, self._topic, user_data=IDLE)
        self._idle = True
        self._references = RawWriter(participant, REFERENCE)
        self._steps = RawWriter(participant, POLICY, depth=_STEPS_DEPTH) if steps else None
        self._states = RawReader(participant, LOWSTATE, depth=_STATE_DEPTH)
        self._others = RawReader(participant, self._topic, ignore_own=True, user_data=OBSERVER)
        self._gaps = TickGaps()
        self._state_turns = PublishersByTurns()
        self._several = False
        self._since = time.monotonic()
        self._bridge: AnnouncedBridge | None = None
        self._published: set[int] = set()  # publishers from which commands were received
        self._known: tuple[tuple[int, int], int] | None = ((0, 0), 0)
        self._other_names: list[str] = []
        tick = Layout.of(LOWSTATE.idl_type)["tick"]
        start = len(CDR_HEADER) + int(tick.offsets)
        self._tick_bytes = slice(start, start + tick.dtype.itemsize)

    def subscribers(self) -> int:
        """Number of matched subscribers of LowCmd, without observers."""
        return self._commands.subscribers()

    def other_publishers(self) -> list[str]:
        # Looking up names takes a fraction of a tick, so it is done only after a writer has
        # appeared, disappeared or begun to publish. A writer that has published counts, even if it
        # announces to be idle.
        samples = self._others.take()
        self._published.update(one.sample_info.publication_handle for one in samples)
        known = self._others.matches, len(self._published)
        if known != self._known:
            participant = self._participant
            writers = participant.writers(self._topic.name)
            unknown = known[0][0] - len(writers)
            self._known = None if unknown > 0 else known  # some are not announced yet: try again
            self._other_names = [
                *(
                    participant.owner(one)
                    for one in writers
                    if not one.idle or one.handle in self._published
                ),
                *["an unnamed participant"] * unknown,
            ]
        return self._other_names

    def announced(self) -> tuple[str | None, str | None]:
        bridge = AnnouncedBridge.by(self._participant.writers(LOWSTATE.name))
        self._bridge = bridge or self._bridge
        return (bridge.support, bridge.robot or None) if bridge else (None, None)

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
        """As of `Link`; nothing is sent after the guard process has taken over."""
        heartbeat = self._heartbeat
        if heartbeat is None:
            written = self._write(command, stamp)
        elif heartbeat.takeover:  # the guard goes on from the command before, which stays
            self._participant.cut_off()
            return 0
        else:
            heartbeat.begin_write(command, time.monotonic_ns())
            written = 0
            try:
                if heartbeat.takeover:
                    self._participant.cut_off()
                    return 0
                written = self._write(command, stamp)
            finally:
                heartbeat.end_write(sent=written > 0)
        self._references.write(reference, stamp)
        return written

    def send_step(self, data: bytes, stamp: int) -> None:
        if self._steps:
            self._steps.write(data, stamp)

    def _write(self, command: bytes, stamp: int) -> int:
        if not self._commands.write(command, stamp):
            return 0
        written = time.monotonic_ns()
        if self._idle:
            self._idle = False
            self._commands.announce(PUBLISHING)
        return written

    def unready(self) -> str:
        if not self.subscribers():
            return f"no subscriber on {self._topic.name}"
        if self._heartbeat and not self._heartbeat.subscribers:
            return f"the guard process has found no subscriber on {self._topic.name}"
        several = self._states.matched > 1
        if several and time.monotonic() < self._since + _SECOND_PUBLISHER:
            return "there are several publishers of LowState, of which one may be silent"
        return ""

    def replaced(self) -> str:
        why = self._heartbeat.takeover if self._heartbeat else Takeover.NONE
        return f"the guard process {self._receiver.ending}: this process {why}" if why else ""

    def counts(self) -> dict[str, int | None]:
        """Counters of received and lost messages, by their field names in `StreamSummary`."""
        self.announced()  # for a bridge that has come since the last call
        bridge = self._bridge
        return {
            "states_received": self._gaps.received,
            "states_lost": self._gaps.missed(bridge.tick_step) if bridge else None,
            "tick_jumps": self._gaps.jumps,
            "dds_lost": self._states.lost,
            "states_malformed": self._states.malformed,
            "state_restarts": self._gaps.restarts,
            "commands_dropped": self._commands.dropped,
        }


class OtherPublishers:
    """Detects other publishers of LowCmd, and several publishers of LowState.

    Args:
        link: the link to the robot.
        allow_second_writer: accept another publisher of commands.
        topic: topic of the commands.
    """

    def __init__(self, link: Link, *, allow_second_writer: bool, topic: Topic) -> None:
        self._link, self._topic = link, topic
        self._allow_second_writer = allow_second_writer
        self._next_command_check = self._next_state_check = 0

    def stop(self, now: int, *, waiting: bool) -> Stop | None:
        """Why the session must end because of other publishers, or None.

        Args:
            now: time, ns.
            waiting: the first command has not been sent, so check publishers of LowCmd at every
                call.
        """
        if now >= self._next_state_check:
            self._next_state_check = now + _PERIOD
            if several := self.of_state():
                return several
        if self._allow_second_writer or now < self._next_command_check:
            return None
        if not waiting:
            self._next_command_check = now + _PERIOD
        others = self._link.other_publishers()
        if not others:
            return None
        return Stop("publisher", f"another publisher on {self._topic.name}: {', '.join(others)}")

    def of_state(self) -> Stop | None:
        """Why the session must end because several publish LowState, or None."""
        if not (names := self._link.state_publishers()):
            return None
        text = f"more than one publisher on {LOWSTATE.name}: {', '.join(names)}"
        return Stop("publisher", text)
