"""Takes samples off the wire the moment they arrive, so that their log time means something."""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING, Any

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet

from g1stream.dds.domain import OBSERVER
from g1stream.dds.endpoints import RawReader
from g1stream.dds.messages import Batch
from g1stream.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.dds.domain import Participant
    from g1stream.dds.topics import Topic

__all__ = ["Receiver"]

_WAKE_NS = 20_000_000

#: How long the thread that writes may hold up the one that receives, s: CPython's own 5 ms would be
#: in every other log time.
_SWITCH_INTERVAL = 1e-4


class Receiver:
    """Receives several topics in a thread of its own.

    Args:
        participant: whose domain to listen in.
        topics: what to receive.
        depth: samples of a topic that may wait while this process is not scheduled.
    """

    def __init__(
        self, participant: Participant, topics: Sequence[Topic], depth: int = 4096
    ) -> None:
        self._depth = depth
        self._readers = [
            RawReader(participant, topic, depth, user_data=OBSERVER) for topic in topics
        ]
        self._overflows = dict.fromkeys((topic.name for topic in topics), 0)
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
        """Begin to receive. Until `stop`, the interpreter switches threads more often."""
        self._switch_interval = sys.getswitchinterval()
        sys.setswitchinterval(min(_SWITCH_INTERVAL, self._switch_interval))
        self._thread.start()

    def stop(self) -> None:
        """End; what has been received can still be drained."""
        self._stop.set()
        self._thread.join()
        sys.setswitchinterval(self._switch_interval)
        # Before the readers, which the participant lets go of.
        del self._waitset, self._conditions

    def drain(self) -> dict[str, Batch]:
        """What came since the last drain, by topic name; topics without a sample are left out.

        Raises:
            RecordingError: nothing more can come, and all that came has been drained.
        """
        failure = self._failure  # looked at first: what came before it is in the batches by now
        with self._lock:
            full = {name: batch for name, batch in self._batches.items() if batch.data}
            for name in full:
                self._batches[name] = Batch()
        if failure is not None and not full:
            raise RecordingError(
                f"Samples cannot be received any more: {failure!r}.",
                "Record again; what came until then is in the file.",
            ) from failure
        return full

    def matched(self) -> dict[str, int]:
        """How many writers each topic is matched with."""
        return {reader.topic.name: reader.matched for reader in self._readers}

    def lost(self) -> dict[str, int]:
        """How many samples of each topic are known to be lost.

        A reader's queue that is found full may have lost any number; it counts as one.
        """
        return {r.topic.name: r.lost + self._overflows[r.topic.name] for r in self._readers}

    def malformed(self) -> dict[str, int]:
        """How many samples of each topic came and were not of its type."""
        return {reader.topic.name: reader.malformed for reader in self._readers}

    def _receive(self) -> None:
        try:
            while not self._stop.is_set():
                self._waitset.wait(_WAKE_NS)
                self._take()
        except BaseException as error:  # told by `drain`: nobody sees what ends a thread
            self._failure = error

    def _take(self) -> None:
        for reader in self._readers:
            samples = reader.take(self._depth)
            if not samples:
                continue
            now = time.time_ns()
            if len(samples) >= self._depth:
                self._overflows[reader.topic.name] += 1
            with self._lock:
                batch = self._batches[reader.topic.name]
                batch.data.extend(sample.data for sample in samples)
                batch.publish_times.extend(sample.publish_time for sample in samples)
                batch.log_times.extend([now] * len(samples))
                batch.writers.extend(s.sample_info.publication_handle for s in samples)
