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

from g1stream._version import __version__
from g1stream.errors import RecordingError
from g1stream.session.chunked_file import ChunkedFile
from g1stream.session.format import CHANNELS
from g1stream.session.message_records import message_records
from g1stream.session.metadata import METADATA_NAME, metadata_to_strings
from g1stream.session.open_chunks import OpenChunks
from g1stream.session.output_path import create

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

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
        self._open = OpenChunks(chunk_ns)
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

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def size(self) -> int:
        """Bytes written to the file so far."""
        return self._file.tell()

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; its sequence number counts the topic's messages from 1.

        Args:
            topic: one of `g1stream.session.format.CHANNELS`.
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
            topic: one of `g1stream.session.format.CHANNELS`.
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
            self._file.claim(len(data) + self._end_size(len(self._open.pending)))
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

    def rename(self, path: Path) -> None:
        """Give the file another name, beside its own; what has that name is replaced.

        Raises:
            RecordingError: it cannot have it.
        """
        with self._whole_or_not():
            self.path = self.path.rename(path)

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
                    self._mcap.finish()
        finally:
            self._file.close()

    def flush(self) -> None:
        """Close the open chunks; what does not fit on the disk is dropped.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        size, pending = self._open.size, self._open.take()
        try:
            with self._whole_or_not():
                self._file.claim(size + self._end_size(len(pending)))
                for topic in list(pending):
                    channel = self._mcap.registry.number(CHANNELS[topic])
                    self._mcap.add_chunk(channel, *pending[topic].joined())
                    self._file.settle()
                    del pending[topic]
        finally:
            for topic, dropped in pending.items():
                self.counts[topic] -= len(dropped)

    def _make_room(self, log_times: NDArray[np.int64]) -> int:
        """How many of the messages, one at least, go into the chunks that are open then."""
        fits = self._open.room_for(log_times)
        if not fits:
            self.flush()
            fits = self._open.room_for(log_times)
        return fits

    def _add(
        self,
        topic: str,
        payloads: Sequence[bytes] | NDArray[np.uint8],
        log_times: NDArray[np.int64],
        publish_times: NDArray[np.int64],
    ) -> None:
        count = self.counts.get(topic, 0)
        channel = self._mcap.registry.number(CHANNELS[topic])
        records, offsets = message_records(channel, count + 1, payloads, log_times, publish_times)
        pending = self._open.of(topic)
        pending.add(records, log_times, offsets)
        self.counts[topic] = count + len(log_times)
        if pending.size > _CHUNK_BYTES:
            self.flush()

    def _end_size(self, n_open: int) -> int:
        """Bytes to keep free for the end of the file, when so many chunks are still open."""
        return _END_BYTES + _INDEX_BYTES * (self._mcap.n_chunks + n_open)

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
