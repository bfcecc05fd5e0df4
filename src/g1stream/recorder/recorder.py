"""From DDS to a session file: an independent observer of the wire."""

from __future__ import annotations

import time
from collections import defaultdict
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from g1stream.dds.topics import TOPICS
from g1stream.errors import RecordingError
from g1stream.foxglove.encoders import encode_log
from g1stream.foxglove.pipeline import CHANNEL_OF
from g1stream.recorder.clocks import DelayEstimator, StepDetector, read_clocks
from g1stream.recorder.losses import Losses, dropped_datagrams
from g1stream.recorder.receiver import Receiver
from g1stream.recorder.recorder_report import Publishers, RecorderReport
from g1stream.types import ERROR, INFO, WARNING

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.dds.domain import Participant
    from g1stream.foxglove.pipeline import MessagePipeline
    from g1stream.recorder.clocks import ClockReading
    from g1stream.session.rotation import PartedWriter
    from g1stream.session.samples import Batch

__all__ = ["Recorder"]


#: A delay beyond this, either way, is told while it can still be mended.
_FAR_NS = 20_000_000

#: Between two looks at what the kernel dropped, s.
_LOOK_EVERY_S = 1.0


class Recorder:
    """Records what is on the wire.

    Args:
        participant: whose domain to listen in.
        writer: the session file.
        pipeline: makes the file's messages.
        batch: how often samples are handed on, s.
        on_event: is told what is worth telling, (level, text); it goes into /log as well.
        clocks: reads this machine's clocks.
    """

    def __init__(
        self,
        participant: Participant,
        writer: PartedWriter,
        pipeline: MessagePipeline,
        batch: float,
        *,
        on_event: Callable[[int, str], None] = lambda level, text: None,
        clocks: Callable[[], ClockReading] = read_clocks,
    ) -> None:
        self._participant = participant
        self._writer = writer
        self._batch_s = batch
        self._on_event = on_event
        self._clocks = clocks
        self._receiver = Receiver(participant, TOPICS)
        self._pipeline = pipeline
        self._losses = Losses()
        self._steps = StepDetector()
        self._delays: dict[str, DelayEstimator] = defaultdict(DelayEstimator)
        self._publishers: dict[str, Publishers] = {}
        self._next_look = 0.0
        self.report = RecorderReport()

    def matched(self) -> dict[str, int]:
        """How many writers each DDS topic is matched with."""
        return self._receiver.matched()

    def run(
        self,
        should_stop: Callable[[], bool],
        linger: float = 0.3,
        on_started: Callable[[], None] = lambda: None,
    ) -> RecorderReport:
        """Record until told to stop, or until nothing can be received or written any more.

        The latter is no exception: the report says so, and the file is in order.

        Args:
            should_stop: asked a few times a second.
            linger: go on for so long afterwards, for what is still on its way, s.
            on_started: called when samples are being received; may take its time, or raise.
        """
        self._receiver.start()
        try:
            on_started()
            while not should_stop():
                time.sleep(self._batch_s)
                self._write_batches()
            time.sleep(linger)
            # Once more after the last samples, to hear whether they were the last by accident.
            for _ in range(2):
                self._write_batches()
        except RecordingError as error:
            self.report.stopped = error.cause
            # There is room for last words, if the disk is what failed.
            with suppress(RecordingError):
                self.tell(ERROR, error.cause)
        finally:
            self._receiver.stop()
        self._fill_report()
        return self.report

    def tell(self, level: int, text: str) -> None:
        """Add an event of the recorder's own to /log.

        Args:
            level: 2 info, 3 warning, 4 error.
            text: what happened.
        """
        self._on_event(level, text)
        happened = time.time_ns()
        line = encode_log(happened, level, "record", text)
        self._writer.write("/log", line, time.time_ns(), happened)

    def _write_batches(self) -> None:
        batches = self._receiver.drain()
        for name, batch in batches.items():
            self.report.see(batch.log_times)
            if name in CHANNEL_OF:
                self._watch(name, batch)
        aligned = self._pipeline.base.yaw_offset
        for messages in self._pipeline.encode(batches):
            self._writer.write_batch(*messages)
        if aligned is None and self._pipeline.base.yaw_offset is not None:
            self._tell_alignment()
        self._watch_losses()
        self._watch_clock()
        self._writer.flush_if_due(time.time_ns())

    def _watch(self, name: str, batch: Batch) -> None:
        """Look after numbers, delays and publishers of a topic."""
        self._losses.look(name, batch)
        delay = self._delays[name]
        delay.observe(np.array(batch.log_times), np.array(batch.publish_times))
        if name not in self._publishers and delay.seconds:
            self._publishers[name] = Publishers.of(self._participant, name)
            self._tell_distance(name)

    def _watch_losses(self) -> None:
        for name, number in self._losses.update(self._receiver.lost()).items():
            channel = CHANNEL_OF.get(name, name)
            self.tell(WARNING, f"{number} samples of {channel} did not arrive")
        if time.monotonic() >= self._next_look:
            self._next_look = time.monotonic() + _LOOK_EVERY_S
            more = dropped_datagrams() - self.report.dropped
            if more > 0:
                self.report.dropped += more
                self.tell(WARNING, f"the kernel dropped {more} datagrams: the recorder was late")

    def _watch_clock(self) -> None:
        step = self._steps.observe(self._clocks())
        if step:
            self.tell(
                WARNING,
                f"CLOCK_REALTIME was set by {step / 1e9:+.3f} s: log times before and after do "
                "not compare",
            )

    def _tell_distance(self, name: str) -> None:
        median = self._delays[name].median() or 0
        if abs(median) < _FAR_NS:
            return
        self.tell(
            WARNING,
            f"{CHANNEL_OF[name]} from {self._publishers[name]} is logged {median / 1e9:+.3f} s "
            "after it was published: the clocks differ, or this machine cannot keep up",
        )

    def _tell_alignment(self) -> None:
        base = self._pipeline.base
        self._writer.add_metadata({"measured_tf": base.as_dict()})
        self.tell(
            INFO,
            f"the measured robot is shown turned by {base.yaw_offset:+.3f} rad, to face as the "
            f"reference; its position is from {base.source}",
        )

    def _fill_report(self) -> None:
        report = self.report
        report.counts = {topic: n for topic, n in self._writer.counts.items() if n}
        report.absent = [t for t in CHANNEL_OF.values() if t not in report.counts]
        self._losses.finish()
        self._losses.update(self._receiver.lost())
        report.missing = {
            CHANNEL_OF[name]: n for name, n in self._losses.missing.items() if name in CHANNEL_OF
        }
        report.malformed = {
            CHANNEL_OF.get(name, name): n for name, n in self._receiver.malformed().items() if n
        }
        report.clock = self._steps.as_dict()
        report.measured_tf = self._pipeline.base.as_dict()
        report.paths = [str(path) for path in self._writer.paths]
        for name, delay in self._delays.items():
            publishers = self._publishers.get(name) or Publishers.of(self._participant, name)
            report.add_delay(CHANNEL_OF[name], publishers, delay.median())
