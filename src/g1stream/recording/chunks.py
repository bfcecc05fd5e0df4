"""Lays out an MCAP whose chunks are made as arrays, a row for each time.

The stock writer takes message after message. Where the messages of a channel are all of one size, a
chunk can be one array instead: the records' heads and the messages themselves are put in by column.
What is around the chunks is written with mcap's own records.
"""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any, Final, Literal, NamedTuple

import fastcrc
import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

__all__ = ["MESSAGE_HEAD", "ChunkedFile", "Compression", "Messages"]

Compression = Literal["zstd", "lz4", "none"]

_MAGIC: Final = b"\x89MCAP0\r\n"
MESSAGE_HEAD: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""A message record without its data: 22 bytes of fields behind opcode and length."""
_RECORD_PREFIX: Final = 9
#: CRC-32 as zlib has it, an order of magnitude faster.
_crc32: Final = fastcrc.crc32.iso_hdlc


class Messages(NamedTuple):
    """Messages of one channel.

    Attributes:
        channel: its number.
        data: (T, size), a message in each row.
        sequence: number of the first of them.
    """

    channel: int
    data: NDArray[np.uint8]
    sequence: int


class ChunkedFile:
    """An MCAP being written to a stream.

    Args:
        stream: where to.
        library: who writes it.
        compression: of the chunks.
    """

    def __init__(self, stream: IO[bytes], library: str, compression: Compression) -> None:
        self._stream = stream
        self._compression = "" if compression == "none" else compression
        self._compress = _compressor(compression)
        # Serialised, so that a long recording does not hold an object for each of its chunks.
        self._chunks = bytearray()
        self._n_chunks = 0
        self._times: tuple[int, int] | None = None
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        stream.write(_MAGIC)
        self._write(Header(profile="", library=library))

    def write_chunk(
        self,
        preface: Sequence[McapRecord],
        messages: Sequence[Messages],
        stamps_ns: NDArray[np.int64],
    ) -> None:
        """Add a chunk: at each time a message of every channel named.

        Args:
            preface: the schemas and channels that are new in this chunk.
            messages: of each channel, T > 0 messages.
            stamps_ns: (T,) both log and publish time, ns since the epoch, rising.
        """
        rows, places = _interleaved(messages, stamps_ns)
        starts = rows.shape[1] * np.arange(len(rows))
        index = {channel: (stamps_ns, starts + place) for channel, place in places.items()}
        self.add_chunk(preface, rows.tobytes(), index)

    def add_chunk(
        self,
        preface: Sequence[McapRecord],
        records: bytes,
        places: Mapping[int, tuple[NDArray[np.int64], NDArray[np.int64]]],
    ) -> None:
        """Add a chunk of ready message records.

        Args:
            preface: the schemas and channels that are new in this chunk.
            records: the messages.
            places: by channel, of its T > 0 messages: (T,) log times, ns since the epoch, and (T,)
                where their records begin in `records`.
        """
        before = _serialised(preface)
        data = before + records
        times = [log_times for log_times, _ in places.values()]
        index = ChunkIndex(
            chunk_length=0,
            chunk_start_offset=self._stream.tell(),
            compression=self._compression,
            compressed_size=0,
            message_start_time=min(int(t.min()) for t in times),
            message_end_time=max(int(t.max()) for t in times),
            message_index_length=0,
            message_index_offsets={},
            uncompressed_size=len(data),
        )
        compressed = self._compress(data)
        index.compressed_size = len(compressed)
        index.chunk_length = self._write(
            Chunk(
                compression=self._compression,
                data=compressed,
                message_start_time=index.message_start_time,
                message_end_time=index.message_end_time,
                uncompressed_crc=_crc32(data),
                uncompressed_size=len(data),
            )
        )
        for channel, (log_times, offsets) in places.items():
            index.message_index_offsets[channel] = self._stream.tell()
            index.message_index_length += self._stream.write(
                _message_index(channel, log_times, len(before) + offsets)
            )
        self._chunks += _serialised([index])
        self._n_chunks += 1
        first, last = self._times or (index.message_start_time, index.message_end_time)
        self._times = (
            min(first, index.message_start_time),
            max(last, index.message_end_time),
        )

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file."""
        times = {"create_time": time_ns, "log_time": time_ns}
        start = self._stream.tell()
        length = self._write(Attachment(name=name, media_type=media_type, data=data, **times))
        self._attachments.append(
            AttachmentIndex(
                offset=start,
                length=length,
                data_size=len(data),
                name=name,
                media_type=media_type,
                **times,
            )
        )

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a metadata record."""
        start = self._stream.tell()
        length = self._write(Metadata(name, values))
        self._metadata.append(MetadataIndex(offset=start, length=length, name=name))

    def finish(
        self, schemas: Sequence[Schema], channels: Sequence[Channel], counts: Mapping[int, int]
    ) -> None:
        """Write the summary, which readers look into first.

        Args:
            schemas: all that there are.
            channels: all that there are.
            counts: messages by channel number.
        """
        self._write(DataEnd(data_section_crc=0))
        start = self._stream.tell()
        groups = {
            Opcode.SCHEMA: _serialised(schemas),
            Opcode.CHANNEL: _serialised(channels),
            Opcode.STATISTICS: _serialised([self._statistics(len(schemas), counts)]),
            Opcode.CHUNK_INDEX: bytes(self._chunks),
            Opcode.ATTACHMENT_INDEX: _serialised(self._attachments),
            Opcode.METADATA_INDEX: _serialised(self._metadata),
        }
        summary, offsets = b"", []
        for opcode, data in groups.items():
            if data:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(data)))
                summary += data
        footer = Footer(start, summary_offset_start=start + len(summary), summary_crc=0)
        summary += _serialised(offsets)
        # The checksum goes over the footer too, up to the checksum itself.
        footer.summary_crc = _crc32(summary + _serialised([footer])[:-4])
        self._stream.write(summary)
        self._write(footer)
        self._stream.write(_MAGIC)

    def _statistics(self, n_schemas: int, counts: Mapping[int, int]) -> Statistics:
        first, last = self._times or (0, 0)
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(counts),
            channel_message_counts=dict(counts),
            chunk_count=self._n_chunks,
            message_count=sum(counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(self._metadata),
            schema_count=n_schemas,
        )

    def _write(self, record: McapRecord) -> int:
        return self._stream.write(_serialised([record]))


def _interleaved(
    messages: Sequence[Messages], stamps_ns: NDArray[np.int64]
) -> tuple[NDArray[np.uint8], dict[int, int]]:
    """Message records (T, width), and where in a row each channel's record begins."""
    n_times = len(stamps_ns)
    width = sum(MESSAGE_HEAD.itemsize + data.shape[1] for _, data, _ in messages)
    rows = np.empty((n_times, width), dtype=np.uint8)
    places: dict[int, int] = {}
    place = 0
    for channel, data, sequence in messages:
        head = np.empty(n_times, MESSAGE_HEAD)
        head["opcode"] = Opcode.MESSAGE
        head["length"] = MESSAGE_HEAD.itemsize - _RECORD_PREFIX + data.shape[1]
        head["channel"] = channel
        head["sequence"] = sequence + np.arange(n_times)
        head["log_time"] = head["publish_time"] = stamps_ns
        places[channel] = place
        body, end = place + MESSAGE_HEAD.itemsize, place + MESSAGE_HEAD.itemsize + data.shape[1]
        rows[:, place:body] = head.view(np.uint8).reshape(n_times, -1)
        rows[:, body:end] = data
        place = end
    return rows, places


def _message_index(channel: int, stamps_ns: NDArray[np.int64], offsets: NDArray[np.int64]) -> bytes:
    """The record of where in its chunk each message of a channel is."""
    entries = np.stack([stamps_ns, offsets], axis=1).astype("<u8").tobytes()
    builder: Any = RecordBuilder()
    builder.start_record(Opcode.MESSAGE_INDEX)
    builder.write2(channel)
    builder.write4(len(entries))
    builder.write(entries)
    builder.finish_record()
    data: bytes = builder.end()
    return data


def _serialised(records: Sequence[McapRecord]) -> bytes:
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()
    return data


def _compressor(compression: Compression) -> Callable[[bytes], bytes]:
    if compression == "zstd":
        import zstandard

        # The doubles of a motion are noise to a compressor: level 3 takes longer and gains nothing.
        return zstandard.ZstdCompressor(level=1).compress
    if compression == "lz4":
        import lz4.frame

        compress: Callable[[bytes], bytes] = lz4.frame.compress
        return compress
    return bytes
