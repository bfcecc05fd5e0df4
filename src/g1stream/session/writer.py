"""Writes a session while it is recorded.

Messages are buffered for a quarter of a second of log time and then written as a chunk for each
topic. A killed program loses at most that time.
"""

from __future__ import annotations

import os
from collections import Counter
from mimetypes import guess_type
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.files import check_output_path, is_session, output_errors, temporary_path
from g1stream.session.format import CHANNELS, MessageBatch
from g1stream.session.mcap_writer import McapWriter, max_size

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from g1stream.config import Config
    from g1stream.dds.messages import Batch
    from g1stream.robot.model import G1
    from g1stream.session.format import Channel
    from g1stream.session.mcap_reader import Messages
    from g1stream.session.records import MotionInfo, SessionInfo
    from g1stream.session.source import MemorySource

__all__ = ["LARGEST_MOTION", "SessionWriter", "attach_motion", "attach_run"]

LARGEST_MOTION: Final = 16 * 2**20
"""A larger motion file is not attached, bytes. Its SHA-256 is always in the metadata."""

_CHUNK_NS: Final = 250_000_000
#: Chunks are written by time, and by size only at very high rates.
_CHUNK_BYTES: Final = 32 * 2**20


class SessionWriter:
    """Writes a session; a context manager.

    Leaving the context closes the file properly, even after an exception or Ctrl-C. On a full disk
    the messages that do not fit are dropped, and space is reserved for the last metadata and the
    index.

    Args:
        path: path of the file; its directory must exist.
        force: replace an existing file.
        channels: channels that may be written, by topic.

    Attributes:
        path: the file.
        exists: whether it is at its path; an old recording is kept there until the first sample.
        counts: number of messages by topic, including buffered ones.
        log_times: first and last log time of the written messages, ns; None without messages.

    Raises:
        RecordingError: something exists that may not be replaced. Every method raises it if
            the disk is full, or if the file cannot be written for another reason.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        force: bool = False,
        channels: Mapping[str, Channel] = CHANNELS,
    ) -> None:
        self._channels = channels
        self._pending: dict[str, list[MessageBatch]] = {}
        self._pending_bytes = 0
        self._chunk_start: int | None = None
        self._closed = False
        self.counts: dict[str, int] = {}
        self.path = Path(path)
        check_output_path(self.path, force=force)
        # An old recording is kept until the first sample of the new one is written.
        self._replaces = os.path.lexists(self.path)
        self._place = temporary_path(self.path) if self._replaces else self.path
        try:
            self._file = McapWriter(self._place, channels)
        except BaseException:
            self._place.unlink(missing_ok=True)
            raise
        self._file.path = self.path

    @property
    def exists(self) -> bool:
        return not self._replaces

    @property
    def log_times(self) -> tuple[int, int] | tuple[None, None]:
        return self._file.log_times

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; times in ns since the epoch.

        Its sequence number counts the topic's messages from 1.
        """
        self.write_batch(topic, (data,), (log_time,), (publish_time,))

    def write_batch(
        self,
        topic: str,
        payloads: Sequence[bytes] | NDArray[np.uint8],
        log_times: ArrayLike,
        publish_times: ArrayLike,
    ) -> None:
        """Add messages of one topic to the same chunk; see `MessageBatch`.

        Raises:
            ValueError: the lengths differ.
        """
        times = np.asarray(log_times, np.int64), np.asarray(publish_times, np.int64)
        batch = MessageBatch(topic, payloads, *times)
        if not len(payloads) == len(batch.log_times) == len(batch.publish_times):
            raise ValueError(
                f"{len(payloads)} payloads with {len(batch.log_times)} log times and "
                f"{len(batch.publish_times)} publish times"
            )
        if not len(payloads):
            return
        start = int(batch.log_times[0])
        if self._is_due(start):
            self.flush()
        if self._chunk_start is None:
            self._chunk_start = start
        self._pending.setdefault(topic, []).append(batch)
        self.counts[topic] = self.counts.get(topic, 0) + len(payloads)
        self._pending_bytes += max_size(batch)
        if self._pending_bytes > _CHUNK_BYTES:
            self.flush()

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Attach a file of a media type such as `text/csv`; its time in ns since the epoch."""
        self._file.attach(name, media_type, data, time_ns)

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add JSON values and numpy arrays to the metadata; a later value replaces an earlier one.

        Raises:
            TypeError: a value is neither.
        """
        self._file.add_metadata(values)

    def copy(
        self,
        metadata: Mapping[str, Any],
        attachments: Mapping[str, bytes],
        time_ns: int,
        batches: Iterable[tuple[str, Batch | Messages]],
    ) -> None:
        """Write what another session has: its messages, by topic, are written as they are read.

        `time_ns` is the time of the attachments, ns since the epoch.
        """
        self.add_metadata(metadata)
        for name, data in attachments.items():
            self.attach(name, guess_type(name)[0] or "application/octet-stream", data, time_ns)
        for topic, batch in batches:
            self.write_batch(topic, batch.data, batch.log_times, batch.publish_times)

    def flush_if_due(self, now_ns: int) -> None:
        """Write the chunks that are due at a log time, ns since the epoch."""
        if self._is_due(now_ns):
            self.flush()

    def flush(self, *, last: bool = False) -> None:
        """Write the buffered messages. Those that do not fit on the disk are dropped.

        With `last` they may use the space that is reserved for the end of the file.
        """
        pending, self._pending = self._pending, {}
        self._pending_bytes, self._chunk_start = 0, None
        waiting = {t: sum(len(one.payloads) for one in batches) for t, batches in pending.items()}
        try:
            for topic, batches in pending.items():
                first = self.counts[topic] - waiting[topic] + 1
                self._file.write_chunk(batches, first, last=last)
                waiting[topic] = 0
        finally:
            for topic, dropped in waiting.items():
                self.counts[topic] -= dropped
        if self._replaces and any(self._channels[topic].dds_topic for topic in pending):
            with output_errors(self.path):
                self._place.replace(self.path)
            self._place, self._replaces = self.path, False
            self._file.place = self.path

    def close(self) -> None:
        """Write the buffered messages and the index, and close the file. It may be called again.

        If that fails, the file is readable up to its last whole chunk. A recording without samples
        does not replace an old one: it is removed.
        """
        if self._closed:
            return
        self._closed = True
        try:
            self.flush(last=True)
        finally:
            self._file.close()
            if self._replaces:
                self._place.unlink(missing_ok=True)

    def _is_due(self, now_ns: int) -> bool:
        # The absolute difference, because a clock may be set back.
        return self._chunk_start is not None and abs(now_ns - self._chunk_start) >= _CHUNK_NS


def attach_run(
    writer: SessionWriter | MemorySource, robot: G1, config: Config, info: SessionInfo, time_ns: int
) -> None:
    """Attach the URDF, the settings, a policy's contract, and the files of the motion.

    `time_ns` is the time of the attachments, ns since the epoch.
    """
    writer.attach("robot.urdf", "application/xml", robot.urdf.encode(), time_ns)
    for name, values in (("config.json", config), ("policy.json", info.policy)):
        if values:
            writer.attach(name, "application/json", values.model_dump_json().encode(), time_ns)
    attach_motion(writer, info.motion, time_ns)


def attach_motion(
    writer: SessionWriter | MemorySource, motion: MotionInfo | None, time_ns: int
) -> None:
    """Attach the source files of a motion and its parts, unless large, missing or sessions.

    If a session is played or converted again, the messages contain everything. Of files with the
    same name, the second is attached as `walk-2.csv`; the hashes in `motion` identify them.
    `time_ns` is their time, ns since the epoch.
    """
    origins = [motion, *motion.parts] if motion else []
    n_alike: Counter[str] = Counter()
    for source in dict.fromkeys(Path(one.source) for one in origins if one.source):
        try:
            large = not source.is_file() or source.stat().st_size > LARGEST_MOTION
            data = b"" if large or is_session(source) else source.read_bytes()
        except OSError:  # a missing source file must not stop a recording
            continue
        if data:
            n_alike[source.name] += 1
            number = f"-{n_alike[source.name]}" if n_alike[source.name] > 1 else ""
            is_table = source.suffix.lower() == ".csv"
            kind = "text/csv" if is_table else "application/octet-stream"
            writer.attach(f"{source.stem}{number}{source.suffix}", kind, data, time_ns)
