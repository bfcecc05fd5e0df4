"""Writes one MCAP file with the library's writer, so that it stays readable however a program ends.

The messages of a topic form their own chunk, so that reading a topic decompresses only that topic.
A chunk is passed to the operating system as soon as it is written, so a killed program leaves a
file that ends with its last whole chunk. A chunk is only begun if the disk has space for it and for
the end of the file, so a file on a full disk still gets its last messages and its index.
"""

from __future__ import annotations

import errno
import fcntl
import os
import pickle
from contextlib import contextmanager, suppress
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, Final

from mcap.records import ChunkIndex
from mcap.writer import CompressionType, IndexType, Writer

from g1stream._version import __version__
from g1stream.errors import RecordingError
from g1stream.files import output_errors
from g1stream.session.format import METADATA_NAME, metadata_to_strings

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from g1stream.session.format import Channel, MessageBatch

__all__ = ["McapWriter", "OutputFile", "max_size"]


#: Space reserved for the end of the file: schemas, statistics, and the index of one chunk.
_SUMMARY_BYTES: Final = 1 << 16
_INDEX_BYTES: Final = 200
#: Space reserved for the last metadata and log messages after a disk is full.
_FINAL_BYTES: Final = 1 << 18
#: Size of a message record without its data, and of its index entry.
_MESSAGE_BYTES: Final = 31 + 16


def max_size(batch: MessageBatch) -> int:
    """Largest size of messages in a file, bytes."""
    return sum(map(len, batch.payloads)) + _MESSAGE_BYTES * len(batch.payloads)


class OutputFile:
    """An unbuffered new file to which only whole pieces are written."""

    def __init__(self, path: Path) -> None:
        self._file: Any = path.open("xb", buffering=0)
        with suppress(OSError):  # a file system without locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until the recorder ends
        self._committed = 0

    def write(self, data: bytes) -> int:
        """Write all data. After an OSError call `rollback` to remove the written part."""
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]
        return len(data)

    def tell(self) -> int:
        """Bytes written."""
        position: int = self._file.tell()
        return position

    def flush(self) -> None:
        """Do nothing, because the file is not buffered."""

    def require_space(self, size: int) -> None:
        """Check that the disk has space for `size` more bytes.

        Raises:
            OSError: there is too little space.
        """
        disk = os.statvfs(self._file.fileno())
        if disk.f_blocks and disk.f_bavail * disk.f_frsize < size:  # 0 blocks: unknown
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def is_at(self, path: Path) -> bool:
        """Whether a path is this file."""
        try:
            return os.path.samestat(path.stat(), os.fstat(self._file.fileno()))
        except FileNotFoundError:
            return False

    def commit(self) -> None:
        """Keep everything that was written so far."""
        self._committed = self.tell()

    def rollback(self) -> None:
        """Remove everything that was written since the last `commit`."""
        with suppress(OSError):
            self._file.truncate(self._committed)
            self._file.seek(self._committed)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class _ChunkIndexes:
    """The index of the chunks so far, on disk, because in memory it would grow by 150 MB an hour.

    It replaces the list in the library's writer. The file has no name in its directory.
    """

    def __init__(self, directory: Path) -> None:
        # Unbuffered, so that closing it writes nothing.
        self._file = TemporaryFile(dir=directory, buffering=0)  # noqa: SIM115

    def append(self, index: ChunkIndex) -> None:
        data = pickle.dumps(tuple(vars(index).values()))
        if self._file.write(data) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def __iter__(self) -> Iterator[ChunkIndex]:
        self._file.seek(0)
        with open(self._file.fileno(), "rb", closefd=False) as file, suppress(EOFError):
            while True:
                yield ChunkIndex(*pickle.load(file))

    def close(self) -> None:
        self._file.close()


class McapWriter:
    """One MCAP file. Every method raises a RecordingError if the file cannot be written.

    Args:
        path: path of the file; its directory must exist.
        channels: channels that may be written, by topic.

    Attributes:
        path: path of the file for error messages.
        place: current path of the file.
        log_times: of the first and the last message, ns since the epoch; None before the first.
    """

    def __init__(self, path: Path, channels: Mapping[str, Channel]) -> None:
        self.path = self.place = path
        self.log_times: tuple[int, int] | tuple[None, None] = (None, None)
        self._channels = channels
        self._channel_ids: dict[str, int] = {}
        self._schema_ids: dict[tuple[str, bytes], int] = {}
        self._n_chunks = self._n_metadata = 0
        with output_errors(path):
            self._file = OutputFile(path)
            try:
                self._indexes = _ChunkIndexes(path.parent)
            except OSError:
                self._file.close()
                path.unlink(missing_ok=True)
                raise
        self._mcap = self._library_writer(summary=True)
        # Profile ros2 requires CDR in all channels; its readers reject files of several encodings.
        only_ros2 = all(channel.message_encoding == "cdr" for channel in channels.values())
        try:
            with self._committed(0):
                self._mcap.start("ros2" if only_ros2 else "", library=f"g1stream {__version__}")
                if only_ros2:
                    # Otherwise rosbag2 assumes its version 9, in which QoS is written in words, for
                    # a file that it opens without metadata.yaml.
                    self._mcap.add_metadata("rosbag2", {"serialized_metadata": ""})
        except BaseException:
            self._file.close()
            self._indexes.close()
            path.unlink(missing_ok=True)
            raise

    def write_chunk(self, batches: Sequence[MessageBatch], sequence: int, *, last: bool) -> None:
        """Write messages of one topic as a chunk, numbered from `sequence` on: all or none.

        With `last` they may use the space that is reserved for the end of a file.
        """
        with output_errors(self.path):
            if not self._file.is_at(self.place):
                raise RecordingError(
                    f"{self.path} was deleted, renamed or replaced while it was recorded.",
                    "Record again.",
                )
        topic, number = batches[0].topic, sequence
        with self._committed(sum(map(max_size, batches)) + (0 if last else _FINAL_BYTES)):
            channel_id = self._channel_id(topic)
            for _, payloads, log_times, publish_times in batches:
                times = zip(log_times.tolist(), publish_times.tolist(), payloads, strict=True)
                for logged, published, data in times:
                    self._mcap.add_message(channel_id, logged, data, published, number)
                    number += 1
            self._mcap.flush()
        self._n_chunks += 1
        ends = [end for one in batches for end in (one.log_times.min(), one.log_times.max())]
        ends += [end for end in self.log_times if end is not None]
        self.log_times = int(min(ends)), int(max(ends))

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Attach a file; see `SessionWriter.attach`."""
        with self._committed(len(data) + _FINAL_BYTES):
            self._mcap.add_attachment(time_ns, time_ns, name, media_type, data)

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add a metadata record; see `SessionWriter.add_metadata`."""
        number = self._n_metadata + 1
        name = METADATA_NAME + (f".{number}" if number > 1 else "")
        strings = metadata_to_strings(values)
        with self._committed(sum(len(k) + len(v) + 8 for k, v in strings.items())):
            self._mcap.add_metadata(name, strings)
        self._n_metadata = number

    def close(self) -> None:
        """Write the summary and close the file."""
        try:
            with output_errors(self.path):
                self._mcap.finish()
        finally:
            self._file.close()
            self._indexes.close()

    def _channel_id(self, topic: str) -> int:
        """The id of a channel. A new channel is registered, and described in the next chunk."""
        if topic not in self._channel_ids:
            channel = self._channels[topic]
            schema = channel.schema_name, channel.build_schema()
            if schema not in self._schema_ids:
                self._schema_ids[schema] = self._mcap.register_schema(
                    channel.schema_name, channel.schema_encoding, schema[1]
                )
            schema_id = self._schema_ids[schema] if channel.schema_name else 0  # 0: none
            self._channel_ids[topic] = self._mcap.register_channel(
                topic, channel.message_encoding, schema_id, dict(channel.metadata)
            )
        return self._channel_ids[topic]

    def _library_writer(self, *, summary: bool) -> Any:
        writer = Writer(
            self._file,  # type: ignore[arg-type]  # it calls write, tell and flush only
            chunk_size=1 << 40,  # never reached, because chunks end with `flush`
            compression=CompressionType.ZSTD,
            index_types=IndexType.ALL if summary else IndexType.NONE,
            repeat_channels=summary,
            repeat_schemas=summary,
            use_statistics=summary,
            use_summary_offsets=summary,
        )
        if summary:
            writer._Writer__chunk_indices = self._indexes  # type: ignore[attr-defined]
        return writer

    def _recover(self) -> None:
        """Remove a piece that was written in part, and continue without a summary.

        The library's writer has counted that piece, so a new writer replaces it. The new one knows
        the same channels, but not what was written before.
        """
        self._file.rollback()
        self._indexes.close()
        self._mcap = self._library_writer(summary=False)
        topics = list(self._channel_ids)
        self._channel_ids.clear()
        self._schema_ids.clear()
        for topic in topics:
            self._channel_id(topic)

    @contextmanager
    def _committed(self, size: int) -> Iterator[None]:
        """Write a piece of `size` bytes if there is space for it and for the end of the file."""
        with output_errors(self.path):
            self._file.require_space(size + _SUMMARY_BYTES + _INDEX_BYTES * (self._n_chunks + 1))
            try:
                yield
                self._file.commit()
            except OSError:  # another program used the space, or there is a quota
                self._recover()
                raise
