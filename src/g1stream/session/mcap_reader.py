"""Reads MCAP files as arrays of messages, including files of killed writers.

The library's readers need the index at the end of the file, or make an object for each message.
This one needs neither: it skips from record to record to find the chunks, stops at the first record
that is not whole, and decompresses only the chunks that have messages of a wanted topic. Where the
index at the end is there and its checksum matches, it skips from chunk to chunk. Messages outside
of chunks, as some writers leave them, are read like a chunk that is not compressed.

The layout is that of the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import stat
import struct
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple, TypeVar, overload
from weakref import finalize

import fastcrc
import numpy as np
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Footer, Header, Metadata, Schema, Statistics

from g1stream.errors import RecordingError
from g1stream.input_limits import LATEST_NS, SESSION_RATIO, UNPACKED
from g1stream.session.format import METADATA_NAME, metadata_from_strings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Future

    from numpy.typing import NDArray

__all__ = ["RECOVER", "ChannelInfo", "McapFile", "Messages", "Slices", "open_mcap"]

RECOVER: Final = "Recover the rest with a tool such as `pymcap-cli recover`."
"""The remedy for a damaged file."""

T = TypeVar("T")
R = TypeVar("R")

_MOST_THREADS: Final = 4
#: Chunks are decompressed in groups; a group ends at this many compressed bytes.
_GROUP: Final = 2**18
#: First size of memory for a group, bytes.
_ROOM: Final = 2**20
#: Most bytes of messages outside of chunks that are read together.
_LOOSE: Final = 2**20
#: First and last bytes of a file.
_MAGIC: Final = b"\x89MCAP0\r\n"
#: Opcode and length of a record. The length counts the bytes after it.
_HEAD: Final = struct.Struct("<BQ")

#: Fields of a chunk record: times, size and checksum of its records, and length of the name of
#: its compression. The name, the length of the compressed data and the data follow.
_CHUNK: Final = struct.Struct("<QQQII")
_LENGTH: Final = struct.Struct("<Q")
#: Of the footer: where the summary and its offsets start, and the checksum of all before that.
_FOOTER: Final = struct.Struct("<QQI")
#: Of a chunk's entry in the summary: its times, where its record starts, how long that is, and how
#: many bytes of channels follow; then the length of the MessageIndex records behind the chunk.
_CHUNK_INDEX: Final = struct.Struct("<QQQQI")
#: A channel and where its MessageIndex record starts.
_CHANNEL: Final = struct.Struct("<HQ")
#: The head of a chunk's record, the times of its messages and the size of the records in it.
_CHUNK_HEAD: Final = struct.Struct("<BQQQQ")

#: Of a MessageIndex record: the channel, and how many bytes of entries follow.
_INDEX: Final = struct.Struct("<HI")
_INDEX_ENTRY: Final = np.dtype([("log_time", "<i8"), ("offset", "<i8")])
#: A Message record without its data.
_MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)


class Messages(NamedTuple):
    """Messages of one topic, in the order of writing.

    Attributes:
        log_times: (N,) int64, receive time, ns since the epoch.
        publish_times: (N,) int64, ns since the epoch.
        data: the N messages, in the encoding of their channel.
    """

    log_times: NDArray[np.int64]
    publish_times: NDArray[np.int64]
    data: Sequence[bytes]


class Slices(Sequence[bytes]):
    """Messages as slices of their chunk, created on access.

    Args:
        chunk: decompressed chunk.
        starts, ends: (N,) start and end of each message in it.
    """

    def __init__(
        self, chunk: memoryview, starts: NDArray[np.int64], ends: NDArray[np.int64]
    ) -> None:
        self._chunk, self._starts, self._ends = chunk, starts, ends

    def __len__(self) -> int:
        return len(self._starts)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> Slices: ...
    def __getitem__(self, index: int | slice) -> bytes | Slices:
        if isinstance(index, slice):
            return Slices(self._chunk, self._starts[index], self._ends[index])
        return bytes(self._chunk[self._starts[index] : self._ends[index]])

    def __iter__(self) -> Iterator[bytes]:
        bounds = zip(self._starts.tolist(), self._ends.tolist(), strict=True)
        return (bytes(self._chunk[start:end]) for start, end in bounds)

    def rows(self) -> NDArray[np.uint8] | None:
        """(N, size) view of messages with equal size and spacing; None if they differ."""
        sizes = self._ends - self._starts
        step = int(self._starts[1] - self._starts[0]) if len(self) > 1 else len(self._chunk)
        even = (np.diff(self._starts) == step).all() and (sizes == sizes[:1]).all()
        if not len(self) or not even or step < sizes[0]:
            return None
        found: NDArray[np.uint8] = np.ndarray(
            (len(self), int(sizes[0])), np.uint8, self._chunk, int(self._starts[0]), (step, 1)
        )
        return found


class ChannelInfo(NamedTuple):
    """The description of a topic's messages in a file. `metadata` is that of the channel."""

    schema_name: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    metadata: dict[str, str]

    def build_schema(self) -> bytes:
        """The schema's data."""
        return self.schema_data


class _Room:
    """Memory that is reused as soon as no array refers to it any more.

    New memory from the operating system for each batch would take as long as the decompression.
    """

    def __init__(self) -> None:
        self._free: list[memoryview] = []

    def take(self, size: int) -> memoryview:
        """Memory of `size` bytes with arbitrary values."""
        try:
            whole = self._free.pop()
        except IndexError:
            whole = np.empty(_ROOM, np.uint8).data
        if len(whole) < size:
            whole = np.empty(size, np.uint8).data
        # An array that numpy makes in a view of another array refers to that array's own memory
        # only. This one has none of its own, so every array in it keeps it alive.
        taken = np.frombuffer(whole, np.uint8, size)
        finalize(taken, self._free.append, whole)
        return taken.data


class _Span(NamedTuple):
    """Start of a record's content, bytes from the start of the file or chunk, and its length."""

    opcode: int
    start: int
    length: int


def _without_zeros(file: IO[bytes]) -> int:
    """Size of a file without the zeros at its end."""
    size = os.fstat(file.fileno()).st_size
    while size:
        start = max(0, size - _LOOSE)
        if rest := len(_read_at(file, start, size - start).rstrip(b"\0")):
            return start + rest
        size = start
    return 0


def _records_in(data: memoryview) -> Iterator[_Span]:
    """The records in a decompressed chunk."""
    start = 0
    while start < len(data):
        opcode, length = _HEAD.unpack_from(data, start)
        start += _HEAD.size
        if not opcode or start + length > len(data):
            raise ValueError("a chunk contains an incomplete record")
        yield _Span(opcode, start, length)
        start += length


def _read_at(file: IO[bytes], start: int, size: int) -> bytes:
    """Read bytes of a file without its buffer, which each skip would refill."""
    return os.pread(file.fileno(), size, start)


def _stream_of(file: IO[bytes], record: _Span) -> ReadDataStream:
    """A record as a stream for the classes of `mcap.records`; limited in size."""
    if record.length > UNPACKED:
        raise ValueError("the record is too large")
    return ReadDataStream(BytesIO(_read_at(file, record.start, record.length)))


def _decompress(content: memoryview, records: memoryview, zstd: zstandard.ZstdDecompressor) -> None:
    """Decompress the records in a chunk, from the content of its own record, to where they fit."""
    _, _, size, crc, name_length = _CHUNK.unpack_from(content)
    if size != len(records):
        raise ValueError("a chunk has another size than it had")
    compression = bytes(content[_CHUNK.size :][:name_length])
    data = content[_CHUNK.size + name_length :]
    (data_length,) = _LENGTH.unpack_from(data)
    data = data[_LENGTH.size :][:data_length]
    # Neither decompressor may make more than the chunk says: a frame has a size of its own.
    if compression == b"zstd" and zstandard.frame_content_size(data) == size:
        found = zstd.stream_reader(data).readinto(records)
    elif compression == b"zstd" and zstandard.frame_content_size(data) == -1:
        found = _copied(zstandard.decompress(data, max_output_size=size), records)
    elif compression == b"lz4":
        found = _copied(LZ4FrameDecompressor().decompress(data, max_length=size), records)
    elif not compression:
        found = _copied(data, records)
    else:
        raise ValueError("a chunk has another size than it says, or an unknown compression")
    if found != size:
        raise ValueError("a chunk has another size than it says")
    # zlib's crc32, which the library uses, takes half as long as the decompression.
    if crc and fastcrc.crc32.iso_hdlc(records) != crc:
        raise ValueError("the checksum of a chunk does not match")


def _copied(data: bytes | memoryview, records: memoryview) -> int:
    """How many bytes were copied: all, which must fit."""
    records[:] = data
    return len(data)


@dataclass
class _Chunk:
    """A chunk and its MessageIndex records. Without an index it must be searched.

    Attributes:
        record: the chunk; of messages outside of chunks, all of their records.
        size: bytes of its records, decompressed.
        loose: whether it is such messages.
        index: by channel, where the entries of its index are and how many.
    """

    record: _Span
    size: int
    loose: bool = False
    index: dict[int, tuple[int, int]] = field(default_factory=dict)

    @classmethod
    def at(cls, file: IO[bytes], record: _Span) -> _Chunk:
        """The chunk of a record, without its index."""
        return cls(record, _CHUNK.unpack(_read_at(file, record.start, _CHUNK.size))[2])

    def add_index(self, file: IO[bytes], record: _Span) -> None:
        channel, size = _INDEX.unpack(_read_at(file, record.start, _INDEX.size))
        n_entries, rest = divmod(size, _INDEX_ENTRY.itemsize)
        if rest or size != record.length - _INDEX.size:
            raise ValueError("the length of a chunk's index does not match its record")
        if n_entries:
            self.index[channel] = (record.start + _INDEX.size, n_entries)

    @property
    def end(self) -> int:
        """End of its last index in the file, or of its own record without an index."""
        ends = (start + n * _INDEX_ENTRY.itemsize for start, n in self.index.values())
        return max(ends, default=self.record.start + self.record.length)

    def offsets(
        self, content: bytes, records: memoryview, channels: set[int]
    ) -> dict[int, NDArray[np.int64]]:
        """By requested channel, (N,) ascending start of its messages in the decompressed `records`.

        `content` is the file's content from the start of the chunk to `end`.
        """
        if not self.index:
            return {c: found for c, found in _message_offsets(records).items() if c in channels}
        found = {}
        for channel, (start, n_entries) in sorted(self.index.items()):
            at = start - self.record.start
            size = n_entries * _INDEX_ENTRY.itemsize
            head = _HEAD.pack(Opcode.MESSAGE_INDEX, _INDEX.size + size) + _INDEX.pack(channel, size)
            if not content.startswith(head, at - len(head)):
                raise ValueError("the index of a chunk is not where the summary says")
            if channel not in channels:
                continue
            entries = np.frombuffer(content, _INDEX_ENTRY, n_entries, at)
            offsets = np.sort(entries["offset"])
            if offsets[0] < 0 or offsets[-1] + _MESSAGE.itemsize > len(records):
                raise ValueError("the index of a chunk points outside of the chunk")
            found[channel] = offsets
        return found


class _Summary(NamedTuple):
    """What the summary at the end of a closed file says; empty where it is absent or damaged.

    Attributes:
        start: where in the file it starts; -1 where there is none.
        records: its records other than the index of chunks.
        chunks: by where it starts, each chunk whose MessageIndex records follow it without a gap,
            where these end, and how the chunk's record must begin.
    """

    start: int
    records: list[_Span]
    chunks: dict[int, tuple[_Chunk, int, bytes]]

    @classmethod
    def of(cls, file: IO[bytes]) -> _Summary:
        tail, nothing = _HEAD.size + _FOOTER.size + len(_MAGIC), cls(-1, [], {})
        end = os.fstat(file.fileno()).st_size - tail
        footer = _read_at(file, max(0, end), tail)
        if not footer.startswith(_HEAD.pack(Opcode.FOOTER, _FOOTER.size)):
            return nothing
        start, _, crc = _FOOTER.unpack_from(footer, _HEAD.size)
        if not crc or not max(0, end - UNPACKED) < start < end:
            return nothing
        data = _read_at(file, start, end - start)
        if fastcrc.crc32.iso_hdlc(data + footer[: _HEAD.size + _FOOTER.size - 4]) != crc:
            return nothing
        found = cls(start, [], {})
        try:
            for record in _records_in(memoryview(data)):
                if record.opcode == Opcode.CHUNK_INDEX:
                    found.add_chunk(data, record)
                else:
                    found.records.append(record._replace(start=start + record.start))
        except (ValueError, struct.error):  # whoever wrote it
            return nothing
        starts = [*sorted(found.chunks), start]
        for at, following in pairwise(starts):
            if found.chunks[at][1] > following:  # it would hide the chunk behind it
                del found.chunks[at]
        return found

    def add_chunk(self, data: bytes, record: _Span) -> None:
        first, last, start, length, n_bytes = _CHUNK_INDEX.unpack_from(data, record.start)
        behind = record.start + _CHUNK_INDEX.size + n_bytes
        (index_length,) = _LENGTH.unpack_from(data, behind)
        (size,) = _LENGTH.unpack_from(data, record.start + record.length - _LENGTH.size)
        end = behind_index = start + length + index_length
        index = {}
        places = _CHANNEL.iter_unpack(data[behind - n_bytes : behind])
        for at, channel in sorted([(at, channel) for channel, at in places], reverse=True):
            first_entry = at + _HEAD.size + _INDEX.size
            n_entries, rest = divmod(end - first_entry, _INDEX_ENTRY.itemsize)
            if rest or n_entries <= 0:
                return
            index[channel], end = (first_entry, n_entries), at
        if index and end == start + length:
            length -= _HEAD.size
            chunk = _Chunk(_Span(Opcode.CHUNK, start + _HEAD.size, length), size, index=index)
            head = _CHUNK_HEAD.pack(Opcode.CHUNK, length, first, last, size)
            self.chunks[start] = chunk, behind_index, head


def _message_offsets(data: memoryview) -> dict[int, NDArray[np.int64]]:
    """By channel, (N,) where in a decompressed chunk its messages are, without an index."""
    found: dict[int, list[int]] = {}
    for record in _records_in(data):
        if record.opcode == Opcode.MESSAGE:
            channel = int.from_bytes(data[record.start : record.start + 2], "little")
            found.setdefault(channel, []).append(record.start - _HEAD.size)
    return {channel: np.array(offsets, dtype=np.int64) for channel, offsets in found.items()}


def _messages_of(
    data: memoryview, ends: NDArray[np.int64], offsets: list[dict[int, NDArray[np.int64]]]
) -> dict[int, Messages]:
    """By channel, the messages of decompressed chunks that end at `ends`, by places in each."""
    starts = np.concatenate([[0], ends[:-1]])
    found = {}
    for channel in offsets[0]:
        in_chunks = [one[channel] for one in offsets]
        where = np.concatenate([at + start for at, start in zip(in_chunks, starts, strict=True)])
        limits = np.repeat(ends, [len(at) for at in in_chunks])
        found[channel] = _messages_at(data, where, limits, channel)
    return found


def _messages_at(
    data: memoryview, offsets: NDArray[np.int64], limits: NDArray[np.int64], channel: int
) -> Messages:
    """The messages of a channel, given the starts of their records (N,) and the chunks' ends."""
    size, head = len(data), _MESSAGE.itemsize
    steps = offsets[1:] - offsets[:-1]
    step = int(steps[0]) if len(steps) else head
    if step > 0 and (steps == step).all():  # DDS samples have equal sizes
        heads = np.ndarray(len(offsets), _MESSAGE, data, int(offsets[0]), (step,))
    else:
        octets = np.frombuffer(data, np.uint8)
        heads = octets[offsets[:, np.newaxis] + np.arange(head)].view(_MESSAGE)[:, 0]
    lengths = np.ascontiguousarray(heads["length"])
    starts, ends = offsets + head, offsets + (_HEAD.size + lengths.clip(0, size))
    wrong = (heads["opcode"] != Opcode.MESSAGE) | (heads["channel"] != channel)
    if (wrong | (ends < starts) | (ends > limits)).any():
        raise ValueError("the index of a chunk does not point to a message")
    times = (np.ascontiguousarray(heads["log_time"]), np.ascontiguousarray(heads["publish_time"]))
    if any(one.min() < 0 or one.max() >= LATEST_NS for one in times):
        raise ValueError("a message has a time after 2116")
    return Messages(*times, Slices(data, starts, ends))


def open_mcap(path: Path) -> IO[bytes]:
    """Open an MCAP file, and check and skip its first bytes.

    Raises:
        RecordingError: it cannot be read, or is no MCAP file.
    """
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
            # Opening a pipe may block, and a pipe cannot seek.
            raise RecordingError(f"{path} is not a file.", "Give an MCAP file.")
        file = path.open("rb")
    except FileNotFoundError as error:
        raise RecordingError(
            f"There is no session file {path}.",
            "Give the path of a session file.",
        ) from error
    except OSError as error:
        raise RecordingError(
            f"The file {path} cannot be read: {error.strerror}.",
            "Check the path and its permissions.",
        ) from error
    magic = file.read(len(_MAGIC))
    if magic != _MAGIC:
        file.close()
        what = "is not an MCAP file" if magic else "is empty"
        raise RecordingError(f"{path} {what}.", "Give a file that g1stream recorded.")
    return file


class McapFile:
    """The messages, metadata and attachments of an MCAP file.

    Args:
        path: path of the file.

    Attributes:
        path: path of the file.
        complete: whether it was closed properly.
        profile: the file's profile, such as `ros2`.
        indexed: whether readers that need the index find all messages.
        unread: bytes at its end that are an incomplete record.
        counts: number of messages by topic.
        channels: description of the messages by topic.
        ambiguous: topics whose channels have different descriptions.
        metadata: values of all of g1stream's metadata records; a later one replaces an earlier.
        metadata_records: all metadata records, including those of other programs.

    Raises:
        RecordingError: there is no such file, or it is not an MCAP, or it is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.complete = self.indexed = False
        self.profile = ""
        self.unread = 0
        self.counts: Counter[str] = Counter()
        self.channels: dict[str, ChannelInfo] = {}
        self.ambiguous: set[str] = set()
        self.metadata: dict[str, Any] = {}
        self.metadata_records: list[Metadata] = []
        self._topics: dict[int, str] = {}
        self._schemas: dict[int, Schema] = {}
        self._chunks: list[_Chunk] = []
        self._attachments: list[_Span] = []
        self._content_size = 0
        self._statistics: Statistics | None = None
        with open_mcap(self.path) as file:
            last = None
            allowed = UNPACKED + SESSION_RATIO * os.fstat(file.fileno()).st_size
            summary = _Summary.of(file)
            for last in self._records(file, summary):
                if known := summary.chunks.get(last.start - _HEAD.size):
                    self._add_chunk(known[0])
                else:
                    with self._damage_at(last):
                        self._add_record(file, last)
                if self._content_size > allowed:
                    raise RecordingError(
                        f"The chunks of {self.path} claim to have "
                        f"{self._content_size / 2**20:.0f} MiB, too much for its size.",
                        "Give a file that g1stream recorded.",
                    )
            # Part of the index of the last chunk may be missing in an incomplete file.
            if last and last.opcode in {Opcode.CHUNK, Opcode.MESSAGE_INDEX}:
                self._chunks[-1].index.clear()
            for channel, count in self._count(file).items():
                self.counts[self._topic(channel)] += count

    @property
    def types(self) -> dict[str, tuple[str, str]]:
        """Schema name and message encoding by topic."""
        return {
            topic: (one.schema_name, one.message_encoding) for topic, one in self.channels.items()
        }

    @property
    def log_times(self) -> tuple[int, int] | tuple[None, None]:
        """First and last log time of all messages, ns; None if the file has no statistics."""
        about = self._statistics
        if about is None or not about.message_count:
            return None, None
        return about.message_start_time, about.message_end_time

    def batches(self, topics: set[str], first_chunk: int = 0) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, in batches of one topic; those of a topic are in order.

        Args:
            topics: names.
            first_chunk: earlier ones are left out; see `place_of`.

        Raises:
            RecordingError: a chunk is damaged.
        """
        channels = {channel for channel, topic in self._topics.items() if topic in topics}
        chunks = [
            chunk
            for chunk in self._chunks[first_chunk:]
            if not chunk.index or not channels.isdisjoint(chunk.index)
        ]
        room = _Room()
        with open_mcap(self.path) as file:

            def read(group: list[_Chunk]) -> dict[int, Messages]:
                ends = np.cumsum([self._size(chunk) for chunk in group])
                records = room.take(int(ends[-1]))
                offsets, zstd = [], zstandard.ZstdDecompressor()
                for chunk, end in zip(group, ends.tolist(), strict=True):
                    data = records[end - chunk.size : end]
                    content = self._unpack(file, chunk, data, zstd)
                    with self._damage_at(chunk.record):
                        offsets.append(chunk.offsets(content, data, channels))
                with self._damage_at(group[0].record):
                    return _messages_of(records, ends, offsets)

            for found in _prefetch(read, _groups(chunks)):
                for channel, messages in found.items():
                    yield self._topic(channel), messages

    def place_of(self, topic: str, number: int) -> tuple[int, int]:
        """The chunk of a topic's message, and how many of the topic are in those before it.

        Both are 0 where the index does not tell: not all chunks have one, or several channels have
        the topic.
        """
        channels = [channel for channel, name in self._topics.items() if name == topic]
        before = 0
        for i, chunk in enumerate(self._chunks):
            if len(channels) != 1 or not chunk.index:
                break
            _, n_messages = chunk.index.get(channels[0], (0, 0))
            if before + n_messages > number:
                return i, before
            before += n_messages
        return 0, 0

    def attachments(self) -> Iterator[Attachment]:
        """The attached files, oldest first.

        Raises:
            RecordingError: one of them is damaged.
        """
        with open_mcap(self.path) as file:
            for record in self._attachments:
                with self._damage_at(record):
                    attachment = Attachment.read(_stream_of(file, record))
                yield attachment

    def _add_record(self, file: IO[bytes], record: _Span) -> None:
        if record.opcode == Opcode.CHUNK:
            self._add_chunk(_Chunk.at(file, record))
        elif record.opcode == Opcode.MESSAGE:
            self._add_message(record)
        elif record.opcode == Opcode.MESSAGE_INDEX and self._chunks and not self._chunks[-1].loose:
            self._chunks[-1].add_index(file, record)
        elif record.opcode == Opcode.HEADER:
            self.profile = Header.read(_stream_of(file, record)).profile
        elif record.opcode == Opcode.SCHEMA:
            self._add_schema(_stream_of(file, record))
        elif record.opcode == Opcode.CHANNEL:
            self._add_channel(_stream_of(file, record))
        elif record.opcode == Opcode.STATISTICS:
            self._statistics = Statistics.read(_stream_of(file, record))
        elif record.opcode == Opcode.ATTACHMENT:
            self._attachments.append(record)
        elif record.opcode == Opcode.METADATA:
            metadata = Metadata.read(_stream_of(file, record))
            self.metadata_records.append(metadata)
            # Sessions before 0.2 have several records of the first name.
            if metadata.name.partition(".")[0] == METADATA_NAME:
                self.metadata |= metadata_from_strings(metadata.metadata)
        elif record.opcode == Opcode.FOOTER:
            self.complete = True
            summary = Footer.read(_stream_of(file, record)).summary_start
            self.indexed = bool(summary) and not any(chunk.loose for chunk in self._chunks)

    def _add_chunk(self, chunk: _Chunk) -> None:
        self._content_size += chunk.size
        self._chunks.append(chunk)

    def _add_message(self, record: _Span) -> None:
        """Add a message outside of a chunk; adjacent ones are read together."""
        start = record.start - _HEAD.size
        before = self._chunks[-1] if self._chunks and self._chunks[-1].loose else None
        if before and before.end == start and before.record.length < _LOOSE:
            size = record.start + record.length - before.record.start
            before.record, before.size = before.record._replace(length=size), size
        else:
            size = _HEAD.size + record.length
            self._chunks.append(_Chunk(_Span(Opcode.MESSAGE, start, size), size, loose=True))

    def _records(self, file: IO[bytes], summary: _Summary) -> Iterator[_Span]:
        """The whole records of a file, up to its footer or to where it was cut.

        Those of a chunk's index are left out where the summary has it, and so is the index of the
        chunks. A chunk whose record does not begin as the summary says is taken out of that.

        A power cut may leave zeros in place of the end of a file. They are no record, and a record
        that ends among them is not whole, but for a chunk whose checksum says so.
        """
        size, filled = os.fstat(file.fileno()).st_size, _without_zeros(file)
        start, self.unread = len(_MAGIC), size - len(_MAGIC)
        while start + _HEAD.size <= size:
            if known := summary.chunks.get(start):
                chunk, end, head = known
                if _read_at(file, start, len(head)) == head and end <= size:
                    start, self.unread = end, size - end
                    yield chunk.record
                    continue
                del summary.chunks[start]
            if start == summary.start:
                yield from summary.records
                start = size - _HEAD.size - _FOOTER.size - len(_MAGIC)
            opcode, length = _HEAD.unpack(_read_at(file, start, _HEAD.size))
            record = _Span(opcode, start + _HEAD.size, length)
            start = record.start + length
            if not opcode or start > size:
                return
            if start > filled and not self._is_whole(file, record, at_end=start == size):
                return
            self.unread = size - start
            yield record
            if opcode == Opcode.FOOTER:
                end = start + len(_MAGIC)
                if _read_at(file, end, len(_MAGIC)) == _MAGIC:
                    raise RecordingError(
                        f"{self.path} is several MCAP files joined together: the first ends "
                        f"at byte {end} of {size}.",
                        f"Split it: `head -c {end}` gives the first, `tail -c +{end + 1}` "
                        "the rest.",
                    )
                self.unread = 0
                return

    def _is_whole(self, file: IO[bytes], record: _Span, *, at_end: bool) -> bool:
        """Whether a record that ends with zeros is complete; `at_end`: nothing follows it."""
        if record.opcode != Opcode.CHUNK:
            return at_end
        try:
            with self._damage_at(record):
                chunk = _Chunk.at(file, record)
            self._unpacked(file, chunk)
        except RecordingError:
            return False
        return True

    def _count(self, file: IO[bytes]) -> Counter[int]:
        """Number of messages by channel; without statistics they are counted chunk by chunk."""
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
        """Read a channel's topic from the chunk with that number, or from an earlier one."""
        for chunk in reversed(self._chunks[: number + 1]):
            self._search(file, chunk)
            if channel in self._topics:
                return
        self._topics[channel] = f"channel {channel}"

    def _search(self, file: IO[bytes], chunk: _Chunk) -> dict[int, int]:
        """Note the channels that a chunk describes, and count its messages by channel."""
        data = self._unpacked(file, chunk)
        with self._damage_at(chunk.record):
            for opcode, start, length in _records_in(data):
                if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    add = self._add_schema if opcode == Opcode.SCHEMA else self._add_channel
                    add(ReadDataStream(BytesIO(data[start : start + length])))
            return {channel: len(found) for channel, found in _message_offsets(data).items()}

    def _size(self, chunk: _Chunk) -> int:
        """Bytes of the records of a chunk, which are not too many."""
        with self._damage_at(chunk.record):
            if chunk.size > UNPACKED:
                raise ValueError("the chunk is too large")
        return chunk.size

    def _unpack(
        self,
        file: IO[bytes],
        chunk: _Chunk,
        records: memoryview,
        zstd: zstandard.ZstdDecompressor,
    ) -> bytes:
        """Write the records of a chunk to where they fit; it and its index as in the file."""
        with self._damage_at(chunk.record):
            size = chunk.end - chunk.record.start
            if size > UNPACKED:
                raise ValueError("the record is too large")
            content = _read_at(file, chunk.record.start, size)
            if chunk.loose:
                records[:] = content
            else:
                _decompress(memoryview(content)[: chunk.record.length], records, zstd)
        return content

    def _unpacked(self, file: IO[bytes], chunk: _Chunk) -> memoryview:
        """The records of a chunk."""
        records = np.empty(self._size(chunk), np.uint8).data
        self._unpack(file, chunk, records, zstandard.ZstdDecompressor())
        return records

    @contextmanager
    def _damage_at(self, record: _Span) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # every field and compression raises its own errors
            raise RecordingError(
                f"The file {self.path} is damaged: the record at byte {record.start} cannot be "
                "decoded.",
                RECOVER,
            ) from error

    def _topic(self, channel_id: int) -> str:
        return self._topics.get(channel_id, f"channel {channel_id}")

    def _add_channel(self, content: ReadDataStream) -> None:
        channel = Channel.read(content)
        self._topics[channel.id] = channel.topic
        schema = self._schemas.get(channel.schema_id)
        about = ChannelInfo(
            schema.name if schema else "",
            schema.encoding if schema else "",
            schema.data if schema else b"",
            channel.message_encoding,
            channel.metadata,
        )
        before = self.channels.setdefault(channel.topic, about)
        if before[:4] != about[:4]:
            self.ambiguous.add(channel.topic)

    def _add_schema(self, content: ReadDataStream) -> None:
        schema = Schema.read(content)
        self._schemas[schema.id] = schema


def _groups(chunks: Iterable[_Chunk]) -> Iterator[list[_Chunk]]:
    """Group chunks of the same channels up to some size, because each batch takes extra time.

    The chunks of a channel keep their order.
    """
    groups: dict[frozenset[int], list[_Chunk]] = {}
    sizes: Counter[frozenset[int]] = Counter()
    for chunk in chunks:
        channels = frozenset(chunk.index)
        if channels not in groups and (len(channels) != 1 or any(len(c) > 1 for c in groups)):
            yield from groups.values()
            groups = {}
            sizes.clear()
        groups.setdefault(channels, []).append(chunk)
        sizes[channels] += chunk.record.length
        if not channels or sizes[channels] >= _GROUP:
            yield groups.pop(channels)
            del sizes[channels]
    yield from groups.values()


def _prefetch(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yield work(item) for each item in order, computed by threads a few items ahead.

    Unlike `Executor.map`, it takes items only as results are taken, so memory stays bounded.
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
