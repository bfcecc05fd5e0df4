"""Reads MCAP files as arrays of messages, also files whose writer was killed.

The library's readers need the index at the end of the file, or make an object for each message.
This one needs neither: it skips from record to record to find the chunks, stops at the first record
that is not whole, and decompresses only the chunks that have messages of a wanted topic.
"""

from __future__ import annotations

import os
import stat
from collections import Counter, deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema, Statistics

from g1stream.errors import RecordingError
from g1stream.input_limits import SESSION_RATIO, UNPACKED
from g1stream.session.format import METADATA_NAME, metadata_from_strings
from g1stream.session.mcap_chunks import Chunk, message_offsets, messages_of
from g1stream.session.mcap_records import (
    MAGIC,
    Record,
    content_of,
    content_size,
    decompressed,
    read_at,
    records_in,
    records_of,
    stream_of,
)
from g1stream.session.source import Messages

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Future


__all__ = ["RECOVER", "McapFile"]

RECOVER: Final = "Recover the rest with a tool such as `pymcap-cli recover`."
"""The remedy for a damaged file."""

T = TypeVar("T")
R = TypeVar("R")

_MOST_THREADS: Final = 4
#: Chunks are decompressed some at a time, of together this many bytes at least.
_GROUP: Final = 2**18


class McapFile:
    """The chunked messages, metadata and attachments of an MCAP file.

    Args:
        path: of the file.

    Attributes:
        path: of the file.
        complete: whether it was closed properly.
        counts: messages of each topic.
        types: of each topic, the name of its schema and the encoding of its messages.
        metadata: the values of all of g1stream's metadata records; a later one replaces an earlier.

    Raises:
        RecordingError: there is no such file, or it is not an MCAP, or it is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.complete = False
        self.counts: Counter[str] = Counter()
        self.types: dict[str, tuple[str, str]] = {}
        self.metadata: dict[str, Any] = {}
        self._topics: dict[int, str] = {}
        self._schemas: dict[int, str] = {}
        self._chunks: list[Chunk] = []
        self._attachments: list[Record] = []
        self._content_size = 0
        self._statistics: Statistics | None = None
        with self._open() as file:
            last = None
            allowed = UNPACKED + SESSION_RATIO * os.fstat(file.fileno()).st_size
            for last in records_of(file):
                with self.damage_at(last):
                    self._add_record(file, last)
                if self._content_size > allowed:
                    raise RecordingError(
                        f"The chunks of {self.path} are said to have "
                        f"{self._content_size / 2**20:.0f} MiB, which no session of its size has.",
                        "Give a file that g1stream recorded.",
                    )
            # Of the last chunk of a file cut short, a part of the index may be missing.
            if last and last.opcode in {Opcode.CHUNK, Opcode.MESSAGE_INDEX}:
                self._chunks[-1].index.clear()
            for channel, count in self._count(file).items():
                self.counts[self._topic(channel)] += count

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, in batches of one topic; those of a topic are in order.

        Raises:
            RecordingError: a chunk is damaged.
        """
        channels = {channel for channel, topic in self._topics.items() if topic in topics}
        chunks = [c for c in self._chunks if not c.index or not channels.isdisjoint(c.index)]
        with self._open() as file:

            def read(group: list[Chunk]) -> dict[int, Messages]:
                records, offsets = [], []
                for chunk in group:
                    content, data = self._content(file, chunk)
                    records.append(data)
                    with self.damage_at(chunk.record):
                        offsets.append(chunk.offsets(content, data, channels))
                with self.damage_at(group[0].record):
                    return messages_of(records, offsets)

            for found in _prefetch(read, _groups(chunks)):
                for channel, messages in found.items():
                    yield self._topic(channel), messages

    def attachments(self) -> Iterator[Attachment]:
        """The attached files, oldest first.

        Raises:
            RecordingError: one of them is damaged.
        """
        with self._open() as file:
            for record in self._attachments:
                with self.damage_at(record):
                    attachment = Attachment.read(stream_of(file, record))
                yield attachment

    def _open(self) -> IO[bytes]:
        try:
            mode = self.path.stat().st_mode
            if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                # Opening a pipe may block, and one cannot seek in it.
                raise RecordingError(f"{self.path} is not a file.", "Give an MCAP file.")
            file = self.path.open("rb")
        except OSError as error:
            raise RecordingError(
                f"The file {self.path} cannot be read: {error.strerror}.",
                "Check the path and its permissions.",
            ) from error
        magic = file.read(len(MAGIC))
        if magic != MAGIC:
            file.close()
            what = "is not an MCAP file" if magic else "is empty"
            raise RecordingError(f"{self.path} {what}.", "Give a file that g1stream recorded.")
        return file

    def _add_record(self, file: IO[bytes], record: Record) -> None:
        if record.opcode == Opcode.CHUNK:
            self._content_size += content_size(file, record)
            self._chunks.append(Chunk(record))
        elif record.opcode == Opcode.MESSAGE_INDEX and self._chunks:
            self._chunks[-1].add_index(file, record)
        elif record.opcode == Opcode.SCHEMA:
            self._add_schema(content_of(file, record))
        elif record.opcode == Opcode.CHANNEL:
            self._add_channel(content_of(file, record))
        elif record.opcode == Opcode.STATISTICS:
            self._statistics = Statistics.read(stream_of(file, record))
        elif record.opcode == Opcode.ATTACHMENT:
            self._attachments.append(record)
        elif record.opcode == Opcode.METADATA:
            metadata = Metadata.read(stream_of(file, record))
            # Sessions before 0.2 have several records of the first name.
            if metadata.name.partition(".")[0] == METADATA_NAME:
                self.metadata |= metadata_from_strings(metadata.metadata)
        elif record.opcode == Opcode.FOOTER:
            self.complete = True

    def _count(self, file: IO[bytes]) -> Counter[int]:
        """Messages of each channel; of a file cut short they are counted chunk by chunk."""
        if self._statistics:
            return Counter(self._statistics.channel_message_counts)
        counts: Counter[int] = Counter()
        for number, chunk in enumerate(self._chunks):
            found = {channel: n for channel, (_, n) in chunk.index.items()}
            found = found or self._search(file, chunk)
            counts.update(found)
            for channel in found.keys() - self._topics.keys():
                self._find_topic(file, channel, number)
        return counts

    def _find_topic(self, file: IO[bytes], channel: int, number: int) -> None:
        """Read a channel's topic: in the chunk of that number, or else in one before it."""
        for chunk in reversed(self._chunks[: number + 1]):
            self._search(file, chunk)
            if channel in self._topics:
                return
        self._topics[channel] = f"channel {channel}"

    def _search(self, file: IO[bytes], chunk: Chunk) -> dict[int, int]:
        """Note the channels that a chunk describes, and count its messages by channel."""
        _, data = self._content(file, chunk)
        with self.damage_at(chunk.record):
            for opcode, start, length in records_in(data):
                if opcode == Opcode.SCHEMA:
                    self._add_schema(data[start : start + length])
                elif opcode == Opcode.CHANNEL:
                    self._add_channel(data[start : start + length])
            return {channel: len(found) for channel, found in message_offsets(data).items()}

    def _content(self, file: IO[bytes], chunk: Chunk) -> tuple[bytes, bytes]:
        """A chunk and its index as they are in the file, and its records."""
        with self.damage_at(chunk.record):
            size = chunk.end - chunk.record.start
            if size > UNPACKED:
                raise ValueError("the record is too large")
            content = read_at(file, chunk.record.start, size)
            return content, decompressed(memoryview(content)[: chunk.record.length])

    @contextmanager
    def damage_at(self, record: Record) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # every field and each compression has an error of its own
            raise RecordingError(
                f"The file {self.path} is damaged: the record at byte {record.start} cannot be "
                "decoded.",
                RECOVER,
            ) from error

    def _topic(self, channel_id: int) -> str:
        return self._topics.get(channel_id, f"channel {channel_id}")

    def _add_channel(self, content: bytes) -> None:
        channel = Channel.read(ReadDataStream(BytesIO(content)))
        self._topics[channel.id] = channel.topic
        schema = self._schemas.get(channel.schema_id, "")
        self.types[channel.topic] = schema, channel.message_encoding

    def _add_schema(self, content: bytes) -> None:
        schema = Schema.read(ReadDataStream(BytesIO(content)))
        self._schemas[schema.id] = schema.name


def _groups(chunks: Iterable[Chunk]) -> Iterator[list[Chunk]]:
    """Chunks of the same channels together, until they have some size: each batch takes time, too.

    The chunks of a channel stay in their order.
    """
    groups: dict[frozenset[int], list[Chunk]] = {}
    for chunk in chunks:
        channels = frozenset(chunk.index)
        if channels not in groups and (len(channels) != 1 or any(len(c) > 1 for c in groups)):
            yield from groups.values()
            groups = {}
        group = groups.setdefault(channels, [])
        group.append(chunk)
        if not channels or sum(one.record.length for one in group) >= _GROUP:
            yield groups.pop(channels)
    yield from groups.values()


def _prefetch(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yield work(item) of each item in order, done by threads a few items ahead.

    Unlike `Executor.map`, it takes items only as results are taken, so that memory stays bounded.
    """
    n_threads = min(_MOST_THREADS, os.cpu_count() or 1)
    pending: deque[Future[R]] = deque()
    with ThreadPoolExecutor(n_threads) as pool:
        try:
            for item in items:
                pending.append(pool.submit(work, item))
                if len(pending) > 2 * n_threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
