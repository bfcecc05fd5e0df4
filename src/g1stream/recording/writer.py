"""Writes a session file as it happens, so that it can be read whatever ends the recorder.

An MCAP is a row of chunks, each compressed on its own. What came in a quarter of a second of log
time is handed to the operating system at once, a chunk for every channel, so that a killed recorder
loses less than that much and its file reads up to the last whole chunk; and so that whoever wants
one channel unpacks that one only. A file that was closed has an index as well.
"""

from __future__ import annotations

from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from mcap.records import Channel, Schema

from g1stream._version import __version__
from g1stream.errors import RecordingError
from g1stream.recording.channels import CHANNELS
from g1stream.recording.chunks import ChunkedFile
from g1stream.recording.message_records import PendingMessages, message_records
from g1stream.recording.metadata import METADATA_NAME, metadata_to_strings
from g1stream.recording.output import create

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from types import TracebackType

    from numpy.typing import ArrayLike, NDArray

__all__ = ["SessionWriter"]

_CHUNK_NS: Final = 250_000_000

# Chunks are closed by time; by size only if something floods the file.
_CHUNK_BYTES: Final = 32 * 2**20

#: Kept free for the summary at the end of the file: schemas and last words, and a chunk's index.
_END_BYTES: Final = 1 << 18
_INDEX_BYTES: Final = 160


class SessionWriter:
    """A session file being written; a context manager.

    Leaving the context closes the file properly even on an exception or Ctrl-C. So does a disk that
    is full: what did not fit is dropped, the file stays whole, and there is room for last words.

    Args:
        path: where to; its directory must exist.
        force: replace a file that is there already.
        chunk_ns: close the chunks when this much log time has passed, ns.
        counts: messages that earlier parts of the session have, by topic; goes on counting.

    Attributes:
        path: where to.
        counts: messages taken so far, by topic.

    Raises:
        RecordingError: there is a file already, or none can be made there.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        force: bool = False,
        chunk_ns: int = _CHUNK_NS,
        counts: dict[str, int] | None = None,
    ) -> None:
        self.path = Path(path)
        self.counts: dict[str, int] = {} if counts is None else counts
        self._in_this_file: dict[int, int] = {}
        self._chunk_ns = chunk_ns
        self._chunk_start: int | None = None
        self._n_chunks = 0
        self._pending: dict[str, PendingMessages] = {}
        self._channels: dict[str, Channel] = {}
        self._schemas: dict[str, Schema] = {}
        self._announced: set[int] = set()
        self._file = create(self.path, force=force)
        try:
            with self._whole_or_not():
                self._mcap = ChunkedFile(self._file, f"g1stream {__version__}", "zstd")
        except RecordingError:
            self._file.close()
            if self.path.is_file():  # and no device
                self.path.unlink()
            raise

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Bytes written to the file so far."""
        return self._file.tell()

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; its sequence number counts the topic's messages from 1.

        Args:
            topic: one of `g1stream.recording.channels.CHANNELS`.
            data: the message in the encoding of its channel.
            log_time: when it was received, ns since the epoch.
            publish_time: when its producer published it, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        self.write_batch(topic, (data,), (log_time,), (publish_time,))

    def write_batch(
        self,
        topic: str,
        payloads: Sequence[bytes] | NDArray[np.uint8],
        log_times: ArrayLike,
        publish_times: ArrayLike,
    ) -> None:
        """Add messages of one topic, oldest first.

        Args:
            topic: one of `g1stream.recording.channels.CHANNELS`.
            payloads: (T,) messages, or (T, size) uint8 with one in each row.
            log_times: (T,) when they were received, ns since the epoch.
            publish_times: (T,) when their producer published them, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
            ValueError: the lengths differ.
        """
        logged = np.asarray(log_times, dtype=np.int64)
        published = np.asarray(publish_times, dtype=np.int64)
        if not len(payloads) == len(logged) == len(published):
            raise ValueError(
                f"{len(payloads)} payloads with {len(logged)} log times and {len(published)} "
                "publish times"
            )
        start = 0
        while start < len(logged):
            end = start + self._make_room(logged[start:])
            part = slice(start, end)
            self._add(topic, payloads[part], logged[part], published[part])
            start = end

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file, such as the URDF.

        Args:
            name: what to call it, such as `g1.urdf`.
            media_type: such as `text/csv`.
            data: its content.
            time_ns: now, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        with self._whole_or_not():
            self._file.claim(len(data) + self._end_size())
            self._mcap.attach(name, media_type, data, time_ns)

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add to the session's metadata; a later value of a key replaces an earlier one.

        Args:
            values: anything that JSON can say, and numpy arrays.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
            TypeError: a value is something else.
        """
        with self._whole_or_not():
            self._mcap.add_metadata(METADATA_NAME, metadata_to_strings(values))

    def flush_if_due(self, now_ns: int) -> None:
        """Close the chunks that time has run out for, when no message comes to do it.

        Args:
            now_ns: the time on the clock of the log times, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        self._make_room(np.array([now_ns]))

    def close(self) -> None:
        """Write the index and close the file; after that, nothing.

        Raises:
            RecordingError: that failed; the file reads up to its last whole chunk.
        """
        if self._file.closed:
            return
        try:
            try:
                self.flush()
            finally:
                with self._whole_or_not():
                    self._mcap.finish(
                        [*self._schemas.values()], [*self._channels.values()], self._in_this_file
                    )
        finally:
            self._file.close()

    def _make_room(self, log_times: NDArray[np.int64]) -> int:
        """How many of the messages, one at least, go into the chunks that are open then."""
        if self._chunk_start is None:
            self._chunk_start = int(log_times[0])
        # The distance, not the difference: a clock may be set back.
        fits = np.abs(log_times - self._chunk_start) < self._chunk_ns
        if not fits[0]:
            self.flush()
            return self._make_room(log_times)
        return len(fits) if fits.all() else int(fits.argmin())

    def _add(
        self,
        topic: str,
        payloads: Sequence[bytes] | NDArray[np.uint8],
        log_times: NDArray[np.int64],
        publish_times: NDArray[np.int64],
    ) -> None:
        count = self.counts.get(topic, 0)
        channel = self._channel(topic)
        pending = self._pending.setdefault(topic, PendingMessages())
        records, offsets = message_records(
            channel.id, count + 1, payloads, log_times, publish_times
        )
        pending.add(records, log_times, offsets)
        self.counts[topic] = count + len(log_times)
        if pending.size > _CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Close the open chunks; what does not fit on the disk is dropped.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        pending, self._pending, self._chunk_start = self._pending, {}, None
        try:
            with self._whole_or_not():
                self._file.claim(sum(p.size for p in pending.values()) + self._end_size())
                for topic in list(pending):
                    self._write_chunk(self._channels[topic], pending[topic])
                    del pending[topic]
        finally:
            for topic, dropped in pending.items():
                self.counts[topic] -= sum(map(len, dropped.log_times))

    def _write_chunk(self, channel: Channel, messages: PendingMessages) -> None:
        preface = [] if channel.id in self._announced else [self._schema_of(channel), channel]
        log_times = np.concatenate(messages.log_times)
        places = {channel.id: (log_times, np.concatenate(messages.offsets))}
        self._mcap.add_chunk(preface, b"".join(messages.records), places)
        self._file.settle()
        self._announced.add(channel.id)
        self._n_chunks += 1
        self._in_this_file[channel.id] = self._in_this_file.get(channel.id, 0) + len(log_times)

    def _end_size(self) -> int:
        return _END_BYTES + _INDEX_BYTES * (self._n_chunks + len(self._pending))

    def _schema_of(self, channel: Channel) -> Schema:
        return self._schemas[CHANNELS[channel.topic].schema_name]

    def _channel(self, topic: str) -> Channel:
        known = self._channels.get(topic)
        if known is not None:
            return known
        about = CHANNELS[topic]
        schema = self._schemas.setdefault(
            about.schema_name,
            Schema(
                id=len(self._schemas) + 1,
                name=about.schema_name,
                encoding=about.schema_encoding,
                data=about.build_schema(),
            ),
        )
        self._channels[topic] = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=about.message_encoding,
            metadata={"description": about.description},
            schema_id=schema.id,
        )
        return self._channels[topic]

    @contextmanager
    def _whole_or_not(self) -> Iterator[None]:
        try:
            yield
            self._file.settle()
        except OSError as error:
            with suppress(OSError):
                self._file.take_back()
            raise RecordingError(
                f"The recording {self.path} cannot be written any more: {error.strerror}.",
                "Make room or choose another place; what fitted is in the file.",
            ) from error
