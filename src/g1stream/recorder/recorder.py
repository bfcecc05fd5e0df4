"""Recorder: writes all samples of a DDS domain to a session file, as an independent observer."""

from __future__ import annotations

import logging
import socket
import time
from collections import defaultdict, deque
from contextlib import suppress
from logging.handlers import QueueHandler
from queue import SimpleQueue
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.dds.discovery import GUARD_PROGRAM, AnnouncedBridge, program_of
from g1stream.dds.endpoints import PublishersByTurns
from g1stream.dds.messages import COMMAND_NAMES, LOG, LOWCMD, LOWSTATE, ODOMMODESTATE, POLICY, Log
from g1stream.errors import RecordingError, WireError
from g1stream.events import severity
from g1stream.recorder.diagnostics import (
    Losses,
    StepDetector,
    dropped_datagrams,
    read_clocks,
)
from g1stream.session.format import CHANNEL_OF, MessageBatch, encode_log
from g1stream.session.records import RecorderSummary, TopicDelay
from g1stream.session.streams import LogEvent, Warnings
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping

    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import Batch
    from g1stream.recorder.diagnostics import ClockReading
    from g1stream.recorder.receiver import SampleReceiver
    from g1stream.session.writer import SessionWriter
    from g1stream.view.pipeline import MessagePipeline

__all__ = ["BATCH", "Recorder", "raw_messages"]

_LOGGER = logging.getLogger(__name__)

BATCH: Final = 0.05
"""Interval at which received samples are processed, s."""

#: Median delay, positive or negative, above which a warning is logged during the recording, ns.
_MAX_DELAY_NS: Final = 20_000_000
#: Time between two readings of the kernel's count of discarded datagrams, s.
_DROPS_PERIOD: Final = 1.0
#: Topics that may have one active publisher.
_SINGLE: Final = COMMAND_NAMES | {LOWSTATE.name}
#: Topics that most streams do not publish.
_OCCASIONAL: Final = (COMMAND_NAMES - {LOWCMD.name}) | {POLICY.name, ODOMMODESTATE.name}
#: Number of batches whose median delays are kept; the last minutes, because the offset may drift.
_DELAYS: Final = 8192
#: Maximum wait for awaited publishers, and interval of the checks, s.
_MATCH_TIMEOUT: Final = 10.0
_POLL_PERIOD: Final = 0.02
#: Time of recording after the end, for samples in transit, s.
_LINGER: Final = 0.3


def raw_messages(batches: Mapping[str, Batch]) -> Iterator[MessageBatch]:
    """The messages of every recording: unchanged samples and log lines.

    Args:
        batches: batches by DDS topic name, each oldest first and not empty.
    """
    log = Log()
    for name, batch in batches.items():
        times = np.array(batch.log_times), np.array(batch.publish_times)
        if name in CHANNEL_OF:
            yield MessageBatch(CHANNEL_OF[name], batch.data, *times)
        elif name == LOG.name:
            lines = []
            for data, published in zip(batch.data, batch.publish_times, strict=True):
                log.load(data)
                lines.append(encode_log(published, int(log.level), log.name, log.text))
            yield MessageBatch("/log", lines, *times)


class Publishers(NamedTuple):
    """The publishers of a topic.

    Attributes:
        names: names of the programs, as far as announced.
        hosts: names of their hosts, as far as announced.
        bridge: announcement of g1stream's bridge; None for other publishers.
    """

    names: list[str]
    hosts: list[str]
    bridge: AnnouncedBridge | None

    @classmethod
    def from_participant(cls, participant: Participant, topic: str) -> Publishers:
        """The current publishers of a DDS topic."""
        writers = participant.writers(topic)
        hosts = {writer.host for writer in writers if writer.host}
        names = {participant.owner(writer) for writer in writers}
        return cls(sorted(names), sorted(hosts), AnnouncedBridge.by(writers))

    @property
    def remote(self) -> bool:
        """Whether a publisher is on another host, with another clock."""
        return any(host != socket.gethostname() for host in self.hosts)

    def __str__(self) -> str:
        return " and ".join(self.names) or "a publisher that has left"


class Recorder:
    """Records all topics of a DDS domain, and the events of the logger `g1stream.recorder`.

    Args:
        receiver: receiver of the domain; it is stopped at the end.
        participant: a participant in the same domain, to identify publishers.
        writer: writer of the session file.
        pipeline: makes messages for viewers from the samples.
        clocks: reads this machine's clocks.

    Attributes:
        report: counts and diagnostics of the recording.
    """

    def __init__(
        self,
        receiver: SampleReceiver,
        participant: Participant,
        writer: SessionWriter,
        pipeline: MessagePipeline,
        *,
        clocks: Callable[[], ClockReading] = read_clocks,
    ) -> None:
        self._participant = participant
        self._writer = writer
        self._clocks = clocks
        self._receiver = receiver
        self._pipeline = pipeline
        # Any thread may log events, but only this one writes the file.
        self._events: SimpleQueue[logging.LogRecord] = SimpleQueue()
        self._losses = Losses()
        self._steps = StepDetector()
        # Medians of log minus publish time of batches, ns, by topic. For another host this is the
        # latency plus the offset between the clocks, which cannot be separated in one direction. In
        # a wired network the latency is well below 1 ms.
        self._delays: dict[str, deque[int]] = defaultdict(lambda: deque(maxlen=_DELAYS))
        self._publishers: dict[str, Publishers] = {}
        # Writers of each topic so far, and topics whose delay from the newest one has been checked.
        self._writers: dict[str, set[int]] = defaultdict(set)
        self._timed: set[str] = set()
        self._late_hosts: set[tuple[str, ...]] = set()
        self._turns: dict[str, PublishersByTurns] = defaultdict(PublishersByTurns)
        self._warnings = Warnings()
        self._last_command = 0
        self._drops_due = 0.0
        self._aligned = self._overrun = False
        self.report = RecorderSummary()

    @property
    def received(self) -> dict[str, int]:
        """Number of samples in the file so far, by the channels of DDS topics."""
        counts = self._writer.counts
        return {channel: n for channel in CHANNEL_OF.values() if (n := counts.get(channel))}

    def run(
        self,
        should_stop: Callable[[], bool],
        on_ready: Callable[[], None] = lambda: None,
        awaited: Collection[str] = (),
    ) -> RecorderSummary:
        """Record until `should_stop` returns True, or until receiving or writing fails.

        A failure does not raise an error. The report has its cause, and the file is complete until
        the failure.

        Args:
            should_stop: called at every batch.
            on_ready: called when all samples are received from now on.
            awaited: DDS topics that must have a publisher before `on_ready` is called.

        Raises:
            ChildError: the receiver does not start.
            WireError: there is no publisher of an awaited topic in time.
        """
        room = logging.getLogger("g1stream.recorder")
        handler = QueueHandler(self._events)
        handler.setLevel(logging.INFO)
        room.addHandler(handler)
        try:
            self._receiver.wait_until_ready(abandoned=should_stop)
            deadline = time.monotonic() + _MATCH_TIMEOUT
            while not self._is_matched(awaited, deadline) and not should_stop():
                time.sleep(_POLL_PERIOD)
                self._write_batches()
            if not should_stop():
                on_ready()
            while not should_stop():
                time.sleep(BATCH)
                self._write_batches()
            time.sleep(_LINGER)
            self._receiver.stop()
            while self._write_batches():
                pass
        except RecordingError as error:
            self.report.stopped = error.cause
            _LOGGER.error(error.cause)
            self._receiver.stop()  # its samples are no longer read
            # If the disk is full, the writer has reserved space for these.
            with suppress(RecordingError):
                self._write_events()
        finally:
            room.removeHandler(handler)
        self._fill_report()
        return self.report

    def _is_matched(self, topics: Collection[str], deadline: float) -> bool:
        """Return whether all topics have a publisher.

        Raises:
            WireError: a topic has no publisher after the deadline.
        """
        matched = self._receiver.counts.matched
        absent = [topic for topic in topics if not matched[topic]]
        if absent and time.monotonic() >= deadline:
            raise WireError(
                f"No publisher of {' or '.join(absent)} was found within {_MATCH_TIMEOUT:g} s.",
                "Check with `g1stream doctor` that the recorder and the stream see each other on "
                "this domain and interface.",
            )
        return not absent

    def _write_batches(self) -> bool:
        """Write some of the waiting samples; return whether there were any."""
        batches = self._receiver.drain()
        # The newest of the last batches, not the maximum of all, because the clock may be set back.
        newest = [batch.log_times[-1] for name, batch in batches.items() if name in CHANNEL_OF]
        self.report.last_ns = max(newest, default=self.report.last_ns)
        for name, batch in batches.items():
            if name in CHANNEL_OF:  # events of a program alone do not count as a recording
                self.report.first_ns = self.report.first_ns or batch.log_times[0]
                self._losses.add(name, batch)
                self._check_publishers(name, batch)
                self._check_delay(name, batch)
        if commands := batches.get(LOWCMD.name):
            self._last_command = commands.log_times[-1]
        for messages in (*raw_messages(batches), *self._pipeline.encode(batches)):
            self._writer.write_batch(*messages)
            if messages.topic == "/log":
                self._warnings.add(map(LogEvent.decode, map(bytes, messages.payloads)))
        self._check_alignment()
        self._check_losses()
        self._check_clock()
        self._write_events()
        # Chunks that would be due before the next batch are written now, so that all samples of a
        # batch are written together, and within the writer's time limit.
        self._writer.flush_if_due(time.time_ns() + round(BATCH * 1e9))
        return bool(batches)

    def _write_events(self) -> None:
        while not self._events.empty():
            record = self._events.get()
            logged = int(record.created * 1e9)
            line = encode_log(logged, severity(record), "record", record.getMessage())
            self._warnings.add([LogEvent.decode(line)])
            self._writer.write("/log", line, time.time_ns(), logged)

    def _check_delay(self, name: str, batch: Batch) -> None:
        delays, known = self._delays[name], self._writers[name]
        if not known.issuperset(batch.writers):  # a restarted publisher may have another clock
            known.update(batch.writers)
            delays.clear()
            self._timed.discard(name)
        delays.append(int(np.median(np.subtract(batch.log_times, batch.publish_times))))
        if name in self._timed or len(delays) * BATCH < 1.0:
            return
        self._timed.add(name)
        self._publishers[name] = Publishers.from_participant(self._participant, name)
        median, hosts = int(np.median(delays)), tuple(self._publishers[name].hosts)
        told = hosts and hosts in self._late_hosts  # its other topics have the same delay
        if abs(median) > _MAX_DELAY_NS and not told:
            self._late_hosts.add(hosts)
            _LOGGER.warning(
                "%s from %s is received %+.3f s after its publish time: "
                "the clocks differ, or this machine is too slow",
                CHANNEL_OF[name],
                self._publishers[name],
                median / 1e9,
            )

    def _check_publishers(self, name: str, batch: Batch) -> None:
        """Report several active publishers of a topic; one may take over from another."""
        if name not in _SINGLE or CHANNEL_OF[name] in self.report.publishers:
            return
        turns = self._turns[name]
        again = [writer for writer in batch.writers if turns.hear(writer)]
        if not again:
            return
        participant = self._participant
        everybody = participant.writers(), participant.readers()
        names = {
            participant.owner(one)
            for one in participant.writers(name)
            # A guard may publish before its stream has ended.
            if program_of(one.participant, *everybody) != GUARD_PROGRAM
        }
        if len(names) > 1:
            self.report.publishers[CHANNEL_OF[name]] = sorted(names)
            _LOGGER.warning(
                "several publishers on %s: %s", CHANNEL_OF[name], ", ".join(sorted(names))
            )

    def _check_losses(self) -> None:
        for name, number in self._update_losses().items():
            _LOGGER.warning("%s of %s lost", counted(number, "sample"), CHANNEL_OF.get(name, name))
        if any(self._receiver.counts.discarded.values()) and not self._overrun:
            self._overrun = True
            _LOGGER.warning(
                "received samples are discarded: this process was stopped, or is too slow"
            )
        if time.monotonic() >= self._drops_due:
            self._drops_due = time.monotonic() + _DROPS_PERIOD
            more = dropped_datagrams(self._receiver.pid) - self.report.dropped_datagrams
            if more > 0:
                self.report.dropped_datagrams += more
                _LOGGER.warning("%s dropped: the socket buffer was full", counted(more, "datagram"))

    def _update_losses(self) -> dict[str, int]:
        """Number of newly lost samples, by topic."""
        states = self._publishers.get(LOWSTATE.name)
        bridge = states.bridge if states else None
        step = bridge.tick_step if bridge else None
        return self._losses.update(self._receiver.counts.lost, state_step=step)

    def _check_clock(self) -> None:
        if step := self._steps.observe(self._clocks()):
            _LOGGER.warning(
                "CLOCK_REALTIME was set by %+.3f s: log times before and after are not comparable",
                step / 1e9,
            )
            # Written immediately, so that the file of a killed recorder has them.
            steps = [one.model_dump() for one in self._steps.steps]
            self._writer.add_metadata({"clock_steps": steps})

    def _check_alignment(self) -> None:
        base = self._pipeline.base
        if base is None or base.yaw_offset is None or self._aligned:
            return
        self._aligned = True
        self._writer.add_metadata({"measured_tf": base.summary().model_dump()})
        _LOGGER.info(
            "the measured yaw is aligned with the reference by %+.3f rad; position from %s",
            base.yaw_offset,
            base.source,
        )

    def _fill_report(self) -> None:
        report = self.report
        report.counts = {topic: n for topic, n in sorted(self._writer.counts.items()) if n}
        expected = [topic for name, topic in CHANNEL_OF.items() if name not in _OCCASIONAL]
        report.absent = [topic for topic in expected if topic not in report.counts]
        for name in self._delays.keys() - self._publishers.keys():
            self._publishers[name] = Publishers.from_participant(self._participant, name)
        self._losses.finish()
        self._update_losses()
        report.lost = {
            CHANNEL_OF[name]: n for name, n in self._losses.lost.items() if name in CHANNEL_OF
        }
        report.malformed = {
            CHANNEL_OF.get(name, name): n
            for name, n in self._receiver.counts.malformed.items()
            if n
        }
        if self._steps.first is not None:
            report.realtime_minus_monotonic_ns = (self._steps.first, self._steps.last)
        report.clock_steps = self._steps.steps
        base = self._pipeline.base
        report.measured_tf = base.summary() if base else None
        report.warnings = self._warnings.texts(self._last_command)
        report.path = str(self._writer.path)
        for name, delays in self._delays.items():
            publishers, median = self._publishers[name], int(np.median(delays))
            report.delays[CHANNEL_OF[name]] = TopicDelay(
                hosts=publishers.hosts,
                median_ns=median,
                clock_offset_estimate_ns=median if publishers.remote else None,
            )
