"""Takes samples off the wire the moment they arrive, so that their log time means something."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet

from g1stream.dds.raw import RawReader

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.dds.domain import Participant
    from g1stream.dds.topics import Topic

__all__ = ["Batch", "Receiver"]

_WAKE_NS = 20_000_000
_MOST = 1024


@dataclass
class Batch:
    """Samples of one topic, oldest first.

    Attributes:
        data: each sample as it is on the wire, CDR header included.
        log_times: when each was received here, CLOCK_REALTIME, ns.
        publish_times: when its writer says it was published, ns.
    """

    data: list[bytes] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    publish_times: list[int] = field(default_factory=list)


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
        self._readers = [RawReader(participant, topic, depth) for topic in topics]
        self._batches = {topic.name: Batch() for topic in topics}
        self._lock = threading.Lock()
        self._stop = threading.Event()
        every = SampleState.NotRead | ViewState.Any | InstanceState.Any
        self._conditions = [ReadCondition(reader.entity, every) for reader in self._readers]
        self._waitset: Any = WaitSet(participant.entity)
        for condition in self._conditions:
            self._waitset.attach(condition)
        self._thread = threading.Thread(target=self._receive, name="receiver", daemon=True)

    def start(self) -> None:
        """Begin to receive."""
        self._thread.start()

    def stop(self) -> None:
        """End; what has been received can still be drained."""
        self._stop.set()
        self._thread.join()
        # Before the readers, which the participant lets go of.
        del self._waitset, self._conditions

    def drain(self) -> dict[str, Batch]:
        """What came since the last drain, by topic name; topics without a sample are left out."""
        with self._lock:
            full = {name: batch for name, batch in self._batches.items() if batch.data}
            for name in full:
                self._batches[name] = Batch()
        return full

    def matched(self) -> dict[str, int]:
        """How many writers each topic is matched with."""
        return {reader.topic.name: reader.matched for reader in self._readers}

    def lost(self) -> dict[str, int]:
        """How many samples each reader knows that it missed."""
        return {reader.topic.name: reader.lost for reader in self._readers}

    def _receive(self) -> None:
        while not self._stop.is_set():
            self._waitset.wait(_WAKE_NS)
            for reader in self._readers:
                samples = reader.take(_MOST)
                if samples:
                    now = time.time_ns()
                    with self._lock:
                        batch = self._batches[reader.topic.name]
                        batch.data.extend(sample.data for sample in samples)
                        batch.publish_times.extend(sample.publish_time for sample in samples)
                        batch.log_times.extend([now] * len(samples))
