"""Reads MCAP files as arrays of messages, including files of killed writers.

A closed file is read by its summary, which the library `mcap` decodes, if its checksum matches and
it lists all that it counts. Any other file is read from record to record, up to the first that is
not whole. Only chunks that have messages of a wanted topic are decompressed. Messages outside of
chunks, as some writers leave them, are read like a chunk that is not compressed.

The layout is that of the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import stat
import struct
from collections import Counter, defaultdict, deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple, overload

import fastcrc
import numpy as np
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader

from g1stream.errors import RecordingError
from g1stream.input_limits import LATEST_NS, SESSION_RATIO, UNPACKED
from g1stream.session.format import METADATA_NAME, metadata_from_strings

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

__all__ = ["RECOVER", "McapFile", "Messages", "Slices"]

RECOVER: Final = "Recover the rest with a tool such as `pymcap-cli recover`."
"""The remedy for a damaged file."""

_MOST_THREADS: Final = 4
#: Chunks are decompressed in groups; a group ends at this many compressed bytes.
_GROUP: Final = 2**18
#: Most bytes of messages outside of chunks that are read together.
_LOOSE: Final = 2**20
#: First and last bytes of a file.
_MAGIC: Final = b"\x89MCAP0\r\n"
#: Opcode and length of a record. The length counts the bytes after it.
_HEAD: Final = struct.Struct("<BQ")
#: Opcode and length of a Message record, and its channel.
_UNPACK: Final = struct.Struct("<BQH").unpack_from
#: Fields of a chunk record: times, size and checksum of its records, and length of the name of
#: its compression. The name, the length of the compressed data and the data follow.
_CHUNK: Final = struct.Struct("<QQQII")
_LENGTH: Final = struct.Struct("<Q")
#: Fields of the footer: where the summary and its offsets start, and the checksum of all before.
_FOOTER: Final = struct.Struct("<QQI")
#: Fields of a MessageIndex record: the channel, and how many bytes of entries follow. Size of what
#: is before the entries, and of an entry.
_INDEX: Final = struct.Struct("<HI")
_INDEX_HEAD, _INDEX_ENTRY = _HEAD.size + _INDEX.size, 16
#: Records that describe messages.
_DESCRIPTIONS: Final[dict[int, type[Schema | Channel]]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
}
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

    def plain(self) -> Messages:
        """The messages without the compression of each one (`compression_mode: message`).

        Raises:
            ValueError: they are larger than 512 MiB unpacked.
            zstandard.ZstdError: one is damaged.
        """
        if not self.data[0].startswith(zstandard.FRAME_HEADER):  # no CDR message begins so
            return self
        sizes = [zstandard.frame_content_size(one) for one in self.data]
        if min(sizes) < 0 or sum(sizes) > UNPACKED:
            raise ValueError("messages are larger unpacked than they may be, or do not say it")
        return self._replace(data=[zstandard.decompress(one) for one in self.data])


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


class _Record(NamedTuple):
    """Where a record starts, bytes from the start of the file or chunk, and its whole length."""

    opcode: int
    start: int
    length: int

    @property
    def end(self) -> int:
        return self.start + self.length


class _Chunk(NamedTuple):
    """A chunk, or adjacent messages outside of chunks.

    Attributes:
        record: the chunk's record, or all the messages' records.
        size: bytes of its records, decompressed.
        counts: number of messages by channel; empty if unknown.
    """

    record: _Record
    size: int
    counts: dict[int, int]

    @classmethod
    def at(cls, file: IO[bytes], record: _Record) -> _Chunk:
        """The chunk of a record in the file."""
        _, _, size, _, _ = _CHUNK.unpack(_read_at(file, record.start + _HEAD.size, _CHUNK.size))
        return cls(record, _limited(size), {})

    @classmethod
    def of_index(cls, index: ChunkIndex) -> _Chunk:
        """The chunk of an entry in the summary; its MessageIndex records follow without gaps."""
        record = _Record(Opcode.CHUNK, index.chunk_start_offset, index.chunk_length)
        counts, end = {}, record.end + index.message_index_length
        starts = index.message_index_offsets
        for channel in sorted(starts, key=starts.__getitem__, reverse=True):
            counts[channel] = (end - starts[channel] - _INDEX_HEAD) // _INDEX_ENTRY
            end = starts[channel]
        return cls(record, index.uncompressed_size, counts)


def _limited(size: int) -> int:
    if size > UNPACKED:
        raise ValueError("a record or chunk is too large")
    return size


def _read_at(file: IO[bytes], start: int, size: int) -> bytes:
    """Read bytes of a file without its buffer, which each skip would refill."""
    return os.pread(file.fileno(), size, start)


def _content(file: IO[bytes], record: _Record) -> bytes:
    """What follows the head of a record in the file."""
    data = _read_at(file, record.start, _limited(record.length))
    head = _HEAD.pack(record.opcode, record.length - _HEAD.size)
    if len(data) < record.length or not data.startswith(head):
        raise ValueError("the record is not where the summary says")
    return data[_HEAD.size :]


def _stream(content: bytes | memoryview) -> ReadDataStream:
    """The content of a record for the classes of `mcap.records`."""
    return ReadDataStream(BytesIO(content))


def _counts(chunks: Iterable[_Chunk]) -> Counter[int]:
    """Number of messages in some chunks by channel."""
    counts: Counter[int] = Counter()
    for chunk in chunks:
        counts.update(chunk.counts)  # which adds
    return counts


def _size_of(file: IO[bytes]) -> int:
    return os.fstat(file.fileno()).st_size


def _without_zeros(file: IO[bytes]) -> int:
    """Size of a file without the zeros at its end."""
    size = _size_of(file)
    while size:
        start = max(0, size - _LOOSE)
        if rest := len(_read_at(file, start, size - start).rstrip(b"\0")):
            return start + rest
        size = start
    return 0


def _summary_of(file: IO[bytes]) -> dict[type, list[Any]]:
    """The records in the summary of a closed file by type; empty if it is absent or damaged."""
    size, end = _HEAD.size + _FOOTER.size + len(_MAGIC), _size_of(file)
    footer = _read_at(file, max(0, end - size), size)
    records: defaultdict[type, list[Any]] = defaultdict(list)
    with suppress(Exception):  # whoever wrote it
        start, _, crc = _FOOTER.unpack_from(footer, _HEAD.size)
        data = _read_at(file, start, _limited(end - start))
        if crc and fastcrc.crc32.iso_hdlc(data[: -len(_MAGIC) - 4]) == crc:
            for record in StreamReader(BytesIO(data), skip_magic=True).records:
                records[type(record)].append(record)
            return records
    return {}


def _records_of(
    data: memoryview,
) -> tuple[dict[int, NDArray[np.int64]], list[tuple[int, memoryview]]]:
    """Where in a chunk the messages of each channel start; opcodes and contents of other records.

    Raises:
        ValueError: a record is not whole.
    """
    found: defaultdict[int, list[int]] = defaultdict(list)
    further: list[tuple[int, memoryview]] = []
    start, size = 0, len(data)
    message, head, least, unpack = int(Opcode.MESSAGE), _HEAD.size, _MESSAGE.itemsize, _UNPACK
    while start < size:
        opcode, length, channel = unpack(data, start)
        end = start + head + length
        if not opcode or end > size or (opcode == message and end - start < least):
            raise ValueError("a chunk contains an incomplete record")
        if opcode != message:
            further.append((opcode, data[start + head : end]))
        else:
            if not found and not (size - start) % (end - start):
                # Samples of DDS have equal sizes, so they may be all alike.
                starts = np.arange(start, size, end - start)
                heads = np.ndarray((len(starts), head + 2), np.uint8, data, start, (end - start, 1))
                if (heads == heads[0]).all():
                    return {channel: starts}, further
            found[channel].append(start)
        start = end
    return {channel: np.array(starts, np.int64) for channel, starts in found.items()}, further


def _messages_at(data: memoryview, starts: NDArray[np.int64]) -> Messages:
    """The messages whose records start there (N,)."""
    head = _MESSAGE.itemsize
    steps = starts[1:] - starts[:-1]
    step = int(steps[0]) if len(steps) else head
    if step > 0 and (steps == step).all():
        heads = np.ndarray(len(starts), _MESSAGE, data, int(starts[0]), (step,))
    else:
        octets = np.frombuffer(data, np.uint8)
        heads = octets[starts[:, np.newaxis] + np.arange(head)].view(_MESSAGE)[:, 0]
    times = (np.ascontiguousarray(heads["log_time"]), np.ascontiguousarray(heads["publish_time"]))
    if any(one.min() < 0 or one.max() >= LATEST_NS for one in times):
        raise ValueError("a message has a time after 2116")
    return Messages(*times, Slices(data, starts + head, starts + _HEAD.size + heads["length"]))


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
        if zstd.stream_reader(data).readinto(records) != size:
            raise ValueError("a chunk has another size than it says")
    elif compression == b"zstd" and zstandard.frame_content_size(data) == -1:
        records[:] = zstandard.decompress(data, max_output_size=size)
    elif compression == b"lz4":
        records[:] = LZ4FrameDecompressor().decompress(data, max_length=size)
    elif not compression:
        records[:] = data
    else:
        raise ValueError("a chunk has another size than it says, or an unknown compression")
    # zlib's crc32, which the library uses, takes half as long as the decompression.
    if crc and fastcrc.crc32.iso_hdlc(records) != crc:
        raise ValueError("the checksum of a chunk does not match")


def _opened(path: Path) -> IO[bytes]:
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
        unread: bytes at its end that are an incomplete record.
        counts: number of messages by topic.
        types: schema name and message encoding by topic.
        metadata: values of all of g1stream's metadata records; a later one replaces an earlier.

    Raises:
        RecordingError: there is no such file, or it is not an MCAP, or it is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.complete = False
        self.unread = 0
        self.counts: Counter[str] = Counter()
        self.types: dict[str, tuple[str, str]] = {}
        self.metadata: dict[str, Any] = {}
        self._topics: dict[int, str] = {}
        self._schemas: dict[int, str] = {}
        self._chunks: list[_Chunk] = []
        self._attachments: list[_Record] = []
        with _opened(self.path) as file:
            if not (indexed := self._use_summary(file)):
                for record in self._records(file):
                    with self._damage_at(record):
                        self._add_record(file, record)
                if not self.complete and self._chunks:  # its index may be incomplete
                    self._chunks[-1].counts.clear()
            claimed = sum(chunk.size for chunk in self._chunks)
            if claimed > UNPACKED + SESSION_RATIO * _size_of(file):
                raise RecordingError(
                    f"The chunks of {self.path} claim to have {claimed / 2**20:.0f} MiB, too much "
                    "for its size.",
                    "Give a file that g1stream recorded.",
                )
            if not indexed:
                for i, chunk in enumerate(self._chunks):
                    self._describe(file, i, chunk)
        for channel, n_messages in _counts(self._chunks).items():
            self.counts[self._topics.setdefault(channel, f"channel {channel}")] += n_messages

    def batches(self, topics: set[str], first_chunk: int = 0) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, in batches of one topic; those of a topic are in order.

        Chunks before `first_chunk` are left out; see `place_of`.

        Raises:
            RecordingError: a chunk is damaged.
        """
        channels = {channel for channel, topic in self._topics.items() if topic in topics}
        chunks = self._chunks[first_chunk:]
        chunks = [chunk for chunk in chunks if not channels.isdisjoint(chunk.counts)]
        n_threads = min(_MOST_THREADS, os.cpu_count() or 1)
        with _opened(self.path) as file, ThreadPoolExecutor(n_threads) as pool:
            waiting = (pool.submit(self._read, file, channels, one) for one in _groups(chunks))
            pending = deque(islice(waiting, 2 * n_threads))  # so that memory stays bounded
            while pending:
                found = pending.popleft().result()
                pending.extend(islice(waiting, 1))
                for channel, messages in found.items():
                    yield self._topics[channel], messages

    def place_of(self, topic: str, number: int) -> tuple[int, int]:
        """The chunk of a topic's message, and how many of the topic are in those before it."""
        channels = [channel for channel, name in self._topics.items() if name == topic]
        before = 0
        for i, chunk in enumerate(self._chunks):
            n_messages = sum(chunk.counts.get(channel, 0) for channel in channels)
            if before + n_messages > number:
                return i, before
            before += n_messages
        return 0, 0

    def attachments(self) -> Iterator[Attachment]:
        """The attached files, oldest first.

        Raises:
            RecordingError: one of them is damaged.
        """
        with _opened(self.path) as file:
            for record in self._attachments:
                with self._damage_at(record):
                    attachment = Attachment.read(_stream(_content(file, record)))
                yield attachment

    def _use_summary(self, file: IO[bytes]) -> bool:
        """Use the summary of a closed file; False if there is none, or not of the whole file."""
        records = _summary_of(file)
        if len(records.get(Statistics, ())) != 1:
            return False
        (about,) = records[Statistics]
        chunks = [_Chunk.of_index(one) for one in records[ChunkIndex]]
        chunks.sort(key=lambda chunk: chunk.record.start)
        counts = _counts(chunks)
        listed = [len(records[kind]) for kind in (ChunkIndex, AttachmentIndex, MetadataIndex)]
        if (
            listed != [about.chunk_count, about.attachment_count, about.metadata_count]
            or counts != Counter(about.channel_message_counts)
            or not counts.keys() <= {channel.id for channel in records[Channel]}
            or any(chunk.size > UNPACKED for chunk in chunks)
        ):
            return False
        self._chunks, self.complete = chunks, True
        for description in (*records[Schema], *records[Channel]):
            self._add_description(description)
        for opcode, kind in (
            (Opcode.ATTACHMENT, AttachmentIndex),
            (Opcode.METADATA, MetadataIndex),
        ):
            for index in sorted(records[kind], key=lambda index: index.offset):
                record = _Record(opcode, index.offset, index.length)
                with self._damage_at(record):
                    self._add_record(file, record)
        return True

    def _records(self, file: IO[bytes]) -> Iterator[_Record]:
        """The whole records of a file, up to its footer or to where it was cut.

        A power cut may leave zeros in place of the end of a file. They are no record, and a record
        that ends among them is not whole, but for a chunk whose checksum says so.
        """
        size, filled, start = _size_of(file), _without_zeros(file), len(_MAGIC)
        while start + _HEAD.size <= size:
            opcode, length = _HEAD.unpack(_read_at(file, start, _HEAD.size))
            record = _Record(opcode, start, _HEAD.size + length)
            if not opcode or record.end > size:
                break
            if record.end > filled and not self._is_whole(file, record, size):
                break
            yield record
            start = record.end
            if opcode == Opcode.FOOTER:
                end = start + len(_MAGIC)
                if _read_at(file, end, len(_MAGIC)) == _MAGIC:
                    raise RecordingError(
                        f"{self.path} is several MCAP files joined together: the first ends "
                        f"at byte {end} of {size}.",
                        f"Split it: `head -c {end}` gives the first, `tail -c +{end + 1}` "
                        "the rest.",
                    )
                self.complete = True
                return
        self.unread = size - start

    def _is_whole(self, file: IO[bytes], record: _Record, size: int) -> bool:
        """Whether a record that ends with zeros is complete."""
        if record.opcode != Opcode.CHUNK:
            return record.end == size
        with suppress(RecordingError), self._damage_at(record):
            self._unpacked(file, [_Chunk.at(file, record)])
            return True
        return False

    def _add_record(self, file: IO[bytes], record: _Record) -> None:
        """Use a record outside of chunks."""
        before = self._chunks[-1] if self._chunks else None
        if record.opcode == Opcode.CHUNK:
            self._chunks.append(_Chunk.at(file, record))
        elif record.opcode == Opcode.MESSAGE_INDEX and before:
            channel, size = _INDEX.unpack(_read_at(file, record.start + _HEAD.size, _INDEX.size))
            if size:
                before.counts[channel] = size // _INDEX_ENTRY
        elif record.opcode == Opcode.MESSAGE:
            loose = before and before.record.opcode == Opcode.MESSAGE and before.record
            if loose and loose.end == record.start and loose.length < _LOOSE:
                record = loose._replace(length=loose.length + record.length)
                self._chunks.pop()
            self._chunks.append(_Chunk(record, record.length, {}))
        elif record.opcode == Opcode.ATTACHMENT:
            self._attachments.append(record)
        elif record.opcode == Opcode.METADATA:
            metadata = Metadata.read(_stream(_content(file, record)))
            # Sessions before 0.2 have several records of the first name.
            if metadata.name.partition(".")[0] == METADATA_NAME:
                self.metadata |= metadata_from_strings(metadata.metadata)
        elif kind := _DESCRIPTIONS.get(record.opcode):
            self._add_description(kind.read(_stream(_content(file, record))))

    def _describe(self, file: IO[bytes], number: int, chunk: _Chunk) -> None:
        """Count the messages of a chunk, whose channels are described in it or an earlier one."""
        if not chunk.counts:
            chunk.counts.update(self._search(file, chunk))
        while number >= 0 and not chunk.counts.keys() <= self._topics.keys():
            self._search(file, self._chunks[number])
            number -= 1

    def _search(self, file: IO[bytes], chunk: _Chunk) -> dict[int, int]:
        """Use the channels that a chunk describes, and count its messages by channel."""
        data = self._unpacked(file, [chunk])
        with self._damage_at(chunk.record):
            found, further = _records_of(data)
            for opcode, content in further:
                if kind := _DESCRIPTIONS.get(opcode):
                    self._add_description(kind.read(_stream(content)))
        return {channel: len(starts) for channel, starts in found.items()}

    def _add_description(self, one: Schema | Channel) -> None:
        if isinstance(one, Schema):
            self._schemas[one.id] = one.name
        else:
            self._topics[one.id] = one.topic
            kind = self._schemas.get(one.schema_id, ""), one.message_encoding
            self.types.setdefault(one.topic, kind)

    def _read(
        self, file: IO[bytes], channels: set[int], group: list[_Chunk]
    ) -> dict[int, Messages]:
        """The messages of some channels in some chunks."""
        data, end = self._unpacked(file, group), 0
        starts: dict[int, list[NDArray[np.int64]]] = defaultdict(list)
        for chunk in group:
            start, end = end, end + chunk.size
            with self._damage_at(chunk.record):
                found, _ = _records_of(data[start:end])
            for channel in channels.intersection(found):
                starts[channel].append(found[channel] + start)
        with self._damage_at(group[0].record):
            return {
                channel: _messages_at(data, np.concatenate(found)).plain()
                for channel, found in starts.items()
            }

    def _unpacked(self, file: IO[bytes], chunks: list[_Chunk]) -> memoryview:
        """The records of some chunks, one after another."""
        records = np.empty(sum(chunk.size for chunk in chunks), np.uint8).data
        zstd, end = zstandard.ZstdDecompressor(), 0
        for chunk in chunks:
            start, end = end, end + chunk.size
            with self._damage_at(chunk.record):
                if chunk.record.opcode == Opcode.MESSAGE:
                    records[start:end] = _read_at(file, chunk.record.start, chunk.record.length)
                else:
                    _decompress(memoryview(_content(file, chunk.record)), records[start:end], zstd)
        return records

    @contextmanager
    def _damage_at(self, record: _Record) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # every field and compression raises its own errors
            raise RecordingError(
                f"The file {self.path} is damaged: the record at byte {record.start} cannot be "
                "decoded.",
                RECOVER,
            ) from error


def _groups(chunks: list[_Chunk]) -> Iterator[list[_Chunk]]:
    """Group chunks up to some size, by channel if each has one: each batch takes extra time."""
    apart = all(len(chunk.counts) == 1 for chunk in chunks)
    groups: defaultdict[int, list[_Chunk]] = defaultdict(list)
    sizes: Counter[int] = Counter()
    for chunk in chunks:
        key = min(chunk.counts) if apart else 0
        groups[key].append(chunk)
        sizes[key] += chunk.record.length
        if sizes[key] >= _GROUP:
            yield groups.pop(key)
            del sizes[key]
    yield from groups.values()
