"""Takes samples from DDS the moment they arrive, which is their log time."""

from __future__ import annotations

import threading
import time
from collections import Counter
from typing import TYPE_CHECKING, Any, Final

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet

from g1stream.dds.domain import OBSERVER
from g1stream.dds.endpoints import RawReader
from g1stream.dds.messages import Batch
from g1stream.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import Topic

__all__ = ["Receiver"]

#: How long the thread waits for samples before it checks whether to stop, ns.
_WAIT_NS: Final = 20_000_000
#: Samples of a topic that may wait while this process is not scheduled.
_DEPTH: Final = 4096


class Receiver:
    """Receives several topics in a thread of its own.

    Args:
        participant: in the domain.
        topics: what to receive.
    """

    def __init__(self, participant: Participant, topics: Sequence[Topic]) -> None:
        self._readers = [
            RawReader(participant, topic, _DEPTH, user_data=OBSERVER) for topic in topics
        ]
        self._overflows: Counter[str] = Counter()
        self._batches = {topic.name: Batch() for topic in topics}
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._failure: BaseException | None = None
        every = SampleState.NotRead | ViewState.Any | InstanceState.Any
        self._conditions = [ReadCondition(reader.entity, every) for reader in self._readers]
        self._waitset: Any = WaitSet(participant.entity)
        for condition in self._conditions:
            self._waitset.attach(condition)
        self._thread = threading.Thread(target=self._receive, name="receiver", daemon=True)

    def start(self) -> None:
        """Begin to receive. The writing thread should not hold the GIL for long meanwhile."""
        self._thread.start()

    def stop(self) -> None:
        """Stop receiving; what has been received can still be drained."""
        self._stop.set()
        self._thread.join()
        # Before the readers, which the participant closes.
        del self._waitset, self._conditions

    def drain(self) -> dict[str, Batch]:
        """The samples since the last drain, by topic name; topics without any are left out.

        Raises:
            RecordingError: the receiving thread failed, and all its samples have been drained.
        """
        failure = self._failure  # read first: samples received before it are in the batches by now
        with self._lock:
            full = {name: batch for name, batch in self._batches.items() if batch.data}
            for name in full:
                self._batches[name] = Batch()
        if failure is not None and not full:
            raise RecordingError(
                f"Receiving samples failed: {failure!r}.",
                "Record again; the file contains all samples until then.",
            ) from failure
        return full

    def matched(self) -> dict[str, int]:
        """How many writers each topic is matched with."""
        return {reader.topic.name: reader.matched for reader in self._readers}

    def lost(self) -> dict[str, int]:
        """How many samples of each topic are known to be lost.

        A reader's queue that was full may have lost any number; it counts as one.
        """
        return {r.topic.name: r.lost + self._overflows[r.topic.name] for r in self._readers}

    def malformed(self) -> dict[str, int]:
        """How many samples of each topic were not of its type."""
        return {reader.topic.name: reader.malformed for reader in self._readers}

    def _receive(self) -> None:
        try:
            while not self._stop.is_set():
                self._waitset.wait(_WAIT_NS)
                self._take()
        except BaseException as error:  # `drain` raises it in the other thread
            self._failure = error

    def _take(self) -> None:
        for reader in self._readers:
            samples = reader.take(_DEPTH)
            if not samples:
                continue
            now = time.time_ns()
            if len(samples) >= _DEPTH:
                self._overflows[reader.topic.name] += 1
            with self._lock:
                batch = self._batches[reader.topic.name]
                batch.data.extend(sample.data for sample in samples)
                batch.publish_times.extend(sample.publish_time for sample in samples)
                batch.log_times.extend([now] * len(samples))
                batch.writers.extend(s.sample_info.publication_handle for s in samples)
