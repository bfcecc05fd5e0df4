"""From DDS to a session file: an independent observer of the wire."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from g1stream.dds.topics import LOWSTATE, REFERENCE, TOPICS
from g1stream.recording.channels import CHANNELS
from g1stream.recording.derive import Deriver
from g1stream.recording.encode import encode_log
from g1stream.recording.receiver import Receiver
from g1stream.recording.samples import Samples

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.config import RecordConfig
    from g1stream.dds.domain import Participant
    from g1stream.recording.receiver import Batch
    from g1stream.recording.writer import SessionWriter
    from g1stream.robot.model import G1

__all__ = ["Recorder", "RecorderReport"]

_WARNING = 3

#: A number that leaps further was not lost on the way: its publisher was started anew, or there are
#: two of them.
_JUMP = 10_000

_CHANNEL_OF = {c.source.name: c.topic for c in CHANNELS.values() if c.source is not None}


@dataclass
class _Counter:
    """Finds holes in a number that each sample carries.

    Attributes:
        step: by how much the number grows from one sample to the next; 0 until it is known.
        missing: samples that the numbers say were published and that did not come.
    """

    path: str
    step: int = 0
    missing: int = 0
    last: int | None = None

    def count(self, samples: Samples) -> int:
        """Look through a batch; returns how many more are missing."""
        numbers = samples[self.path].astype(np.int64)
        steps = np.diff(numbers if self.last is None else np.append(self.last, numbers))
        self.last = int(numbers[-1])
        if not self.step:
            forward = steps[steps > 0]
            self.step = int(np.median(forward)) if forward.size else 0
        if not self.step:
            return 0
        missed = steps // self.step - 1
        found = int(missed[(missed > 0) & (missed < _JUMP)].sum())
        self.missing += found
        return found


@dataclass
class RecorderReport:
    """What a recording holds.

    Attributes:
        counts: messages by topic of the file.
        missing: samples known to be lost, by topic of the file, from the numbers they carry.
        first, last: log times of the first and last sample, ns since the epoch.
    """

    counts: dict[str, int] = field(default_factory=dict)
    missing: dict[str, int] = field(default_factory=dict)
    first: int = 0
    last: int = 0

    def as_dict(self) -> dict[str, Any]:
        """The report as JSON values."""
        return {
            "counts": dict(sorted(self.counts.items())),
            "missing": self.missing,
            "duration_s": (self.last - self.first) / 1e9,
        }


class Recorder:
    """Records what is on the wire.

    Args:
        participant: whose domain to listen in.
        writer: the session file.
        robot: whose links the transforms show.
        config: rates.
    """

    def __init__(
        self, participant: Participant, writer: SessionWriter, robot: G1, config: RecordConfig
    ) -> None:
        self._writer = writer
        self._batch_s = config.batch
        self._receiver = Receiver(participant, TOPICS)
        self._deriver = Deriver(robot, config.tf_rate)
        # LowState's tick is 0 for ever on one of the simulators; then nothing can be known.
        self._counters = {REFERENCE.name: _Counter("tick"), LOWSTATE.name: _Counter("tick")}
        self._topics = {topic.name: topic for topic in TOPICS}
        self.report = RecorderReport()

    def matched(self) -> dict[str, int]:
        """How many writers each DDS topic is matched with."""
        return self._receiver.matched()

    def run(self, should_stop: Callable[[], bool], linger: float = 0.3) -> RecorderReport:
        """Record until told to stop.

        Args:
            should_stop: asked a few times a second.
            linger: go on for so long afterwards, for what is still on its way, s.

        Raises:
            RecordingError: the file cannot be written any more.
        """
        self._receiver.start()
        try:
            while not should_stop():
                time.sleep(self._batch_s)
                self._write_batches()
            time.sleep(linger)
        finally:
            self._receiver.stop()
        self._write_batches()
        self.report.counts = dict(self._writer.counts)
        self.report.missing = {
            _CHANNEL_OF[name]: counter.missing for name, counter in self._counters.items()
        }
        return self.report

    def tell(self, level: int, text: str) -> None:
        """Add an event of the recorder's own to /log."""
        happened = time.time_ns()
        line = encode_log(happened, level, "record", text)
        self._writer.write("/log", line, time.time_ns(), happened)

    def _write_batches(self) -> None:
        batches = self._receiver.drain()
        for name, batch in batches.items():
            self.report.first = self.report.first or batch.log_times[0]
            self.report.last = max(self.report.last, batch.log_times[-1])
            if name in _CHANNEL_OF:
                self._writer.write_batch(
                    _CHANNEL_OF[name], batch.data, batch.log_times, batch.publish_times
                )
            self._count(name, batch)
        for made in self._deriver.derive(batches):
            self._writer.write_batch(*made)
        self._writer.flush_if_due(time.time_ns())

    def _count(self, name: str, batch: Batch) -> None:
        counter = self._counters.get(name)
        if counter is None:
            return
        found = counter.count(Samples(self._topics[name], batch.data))
        if found:
            self.tell(_WARNING, f"{found} samples of {_CHANNEL_OF[name]} did not arrive")
