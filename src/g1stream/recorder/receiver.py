"""Receive samples in a separate process, so that their log times are exact.

The process only waits for samples, takes them and stores the time. It has real-time priority if the
system allows it. It appends the samples to a file in memory. The recorder's process, which encodes
and writes them, may be slow; it frees the part of the file that it has read.
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import time
from collections import defaultdict
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet

from g1stream.child_process import Child, ChildError, Parent, run_child
from g1stream.dds.discovery import OBSERVER
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.messages import TOPICS, Batch
from g1stream.errors import RecordingError
from g1stream.realtime import on_time

if TYPE_CHECKING:
    from collections.abc import Callable

    from g1stream.config import Config

__all__ = ["Counts", "SampleReceiver"]

#: Difference from the priority of the loop; below the loop's DDS threads, above the simulator.
_BELOW_LOOP: Final = 5
#: Maximum wait for samples before the process checks whether to stop, ns.
_WAIT_NS: Final = 20_000_000
#: Queue length of a topic while the process is not scheduled, samples.
_DEPTH: Final = 4096
#: Maximum time that the process takes to end, s.
_STOP_TIMEOUT: Final = 5.0
#: Time between two reports of losses and matches, s.
_STATUS_PERIOD: Final = 0.05
#: Memory for samples that have not been read, bytes; a minute at 1 kHz.
_MOST_BYTES: Final = 256 * 2**20
#: Maximum size of a read, bytes; a recorder that was stopped catches up in steps.
_BLOCK: Final = 4 * 2**20

#: Size of the data, number of the topic, log time, publish time, handle of the writer.
_HEADER: Final = struct.Struct("<IiqqQ")
#: Number instead of a topic's for a record with `Counts` as JSON.
_STATUS: Final = -1
_NAMES: Final = tuple(topic.name for topic in TOPICS)


class Counts(NamedTuple):
    """Counts of the readers, by topic name.

    Attributes:
        matched: number of matched writers.
        malformed: number of samples that were not of the topic's type.
        lost: number of samples known to be lost. A full queue may have lost any number of samples,
            and counts as one.
        discarded: number of lost samples that were discarded because too many were not drained.
    """

    matched: dict[str, int]
    malformed: dict[str, int]
    lost: dict[str, int]
    discarded: dict[str, int]


class SampleReceiver:
    """Context manager that receives all topics of a DDS domain in another process.

    Args:
        config: all settings.

    Attributes:
        counts: counts at the last drain.

    Raises:
        ChildError: the process cannot be started.
    """

    def __init__(self, config: Config) -> None:
        self._file = os.memfd_create("g1stream-samples")
        self._read = self._freed = 0  # bytes of the file, from its start
        self._failure = ""
        self.counts = Counts(*(dict.fromkeys(_NAMES, 0) for _ in Counts._fields))
        priority = max(0, config.realtime.priority - _BELOW_LOOP)
        startup = (config.dds.domain, config.dds.interface, priority, self._file)
        try:
            self._child = Child(
                "receiver", startup, pass_fds=[self._file], on_failure=self._note_failure
            )
        except BaseException:
            os.close(self._file)
            raise

    def __enter__(self) -> SampleReceiver:
        return self

    def __exit__(self, *_: object) -> None:
        self._child.kill()
        os.close(self._file)

    @property
    def pid(self) -> int:
        """Process id of the receiving process."""
        return self._child.pid

    def wait_until_ready(self, abandoned: Callable[[], bool] = lambda: False) -> None:
        """Wait until all samples are received from now on, or until `abandoned` returns True.

        Raises:
            ChildError: the process failed or was not ready in time.
        """
        self._child.wait_until_ready(abandoned=abandoned)

    def stop(self) -> None:
        """Stop receiving; received samples can still be drained."""
        try:
            self._child.finish(timeout=_STOP_TIMEOUT)
        except ChildError as error:
            self._failure = self._failure or error.cause

    def drain(self) -> dict[str, Batch]:
        """Take samples since the last drain, by topic name, without topics that have none.

        If many samples wait, it takes only the oldest.

        Raises:
            RecordingError: receiving failed, and all samples have been drained.
        """
        failure = self._failure  # read first, so that all samples before it are in the file
        block = os.pread(self._file, _BLOCK, self._read)
        batches: dict[str, Batch] = defaultdict(Batch)
        at = 0
        while at + _HEADER.size <= len(block):
            size, number, logged, published, writer = _HEADER.unpack_from(block, at)
            end = at + _HEADER.size + size
            if end > len(block):
                break
            data = block[at + _HEADER.size : end]
            at = end
            if number == _STATUS:
                self.counts = Counts(*json.loads(data))
                continue
            batch = batches[_NAMES[number]]
            batch.data.append(data)
            batch.log_times.append(logged)
            batch.publish_times.append(published)
            batch.writers.append(writer)
        self._read += at
        self._free()
        if failure and not at:
            raise RecordingError(
                failure, "Record again; the file contains all samples until the failure."
            )
        return dict(batches)

    def _note_failure(self, cause: str) -> None:
        self._failure = cause

    def _free(self) -> None:
        """Free the memory of samples that have been read."""
        size = (self._read - self._freed) // mmap.ALLOCATIONGRANULARITY
        size *= mmap.ALLOCATIONGRANULARITY
        if size >= _BLOCK // 4:
            with mmap.mmap(self._file, size, offset=self._freed) as read:
                read.madvise(mmap.MADV_REMOVE)
            self._freed += size


class _Readers:
    """Reads all topics, and appends their samples to a file.

    Args:
        participant: a participant in the domain.
        file: descriptor of the file.
    """

    def __init__(self, participant: Participant, file: int) -> None:
        self._file = file
        self._readers = [
            RawReader(participant, topic, _DEPTH, user_data=OBSERVER) for topic in TOPICS
        ]
        every = SampleState.NotRead | ViewState.Any | InstanceState.Any
        self._conditions = [ReadCondition(reader.entity, every) for reader in self._readers]
        self._waitset: Any = WaitSet(participant.entity)
        for condition in self._conditions:
            self._waitset.attach(condition)
        self._overflows = dict.fromkeys(_NAMES, 0)
        self._discarded = dict.fromkeys(_NAMES, 0)
        self._status = b""  # the last written one

    def receive(self, parent: Parent) -> None:
        """Receive until the parent requests the end."""
        status_due = 0.0
        while not parent.done.is_set():
            self._waitset.wait(_WAIT_NS)
            self._take()
            if time.monotonic() >= status_due:
                status_due = time.monotonic() + _STATUS_PERIOD
                self._write_status()
                parent.beat()
        self._take()
        self._write_status()

    def _take(self) -> None:
        for number, reader in enumerate(self._readers):
            samples = reader.take(_DEPTH)
            if not samples:
                continue
            now = time.time_ns()
            if len(samples) >= _DEPTH:
                self._overflows[_NAMES[number]] += 1
            if os.fstat(self._file).st_blocks * 512 > _MOST_BYTES:
                self._discarded[_NAMES[number]] += len(samples)
                continue
            pieces = []
            for sample in samples:
                info, size = sample.sample_info, len(sample.data)
                times = now, info.source_timestamp
                pieces.append(_HEADER.pack(size, number, *times, info.publication_handle))
                pieces.append(sample.data)
            self._append(b"".join(pieces))

    def _write_status(self) -> None:
        readers = dict(zip(_NAMES, self._readers, strict=True))
        counts = Counts(
            matched={name: one.matched for name, one in readers.items()},
            malformed={name: one.malformed for name, one in readers.items()},
            lost={
                name: one.lost + self._overflows[name] + self._discarded[name]
                for name, one in readers.items()
            },
            discarded=self._discarded,
        )
        data = json.dumps(counts).encode()
        if data != self._status:
            self._status = data
            self._append(_HEADER.pack(len(data), _STATUS, 0, 0, 0) + data)

    def _append(self, data: bytes) -> None:
        if os.write(self._file, data) < len(data):
            raise OSError("there is not enough memory for samples")


def _run_child(parent: Parent) -> None:
    """Receive samples for a recorder."""
    domain, interface, priority, file = parent.startup_message
    with (
        Participant(domain, interface) as participant,
        on_time(priority, helpers=participant.threads),
    ):
        readers = _Readers(participant, file)
        try:
            parent.ready()
            readers.receive(parent)
        except (OSError, MemoryError) as error:
            raise RecordingError(
                f"Receiving samples failed: {error}.", "Free memory and record again."
            ) from error
        finally:
            del readers  # before the participant, which closes the readers' entities


if __name__ == "__main__":
    run_child(_run_child)
