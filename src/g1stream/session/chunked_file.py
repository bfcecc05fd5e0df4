"""Lays out an MCAP: chunks, what lies between them, and the summary that readers look into first.

What is around the messages is written with mcap's own records.
"""

from __future__ import annotations

from collections import Counter
from typing import IO, TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)

from g1stream.session.compression import compressor, crc32
from g1stream.session.magic import MAGIC
from g1stream.session.message_index import message_index
from g1stream.session.message_records import interleaved
from g1stream.session.records import serialised
from g1stream.session.registry import Registry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from g1stream.session.compression import Compression
    from g1stream.session.message_records import Rows

__all__ = ["ChunkedFile"]


class ChunkedFile:
    """An MCAP being written to a stream.

    Args:
        stream: where to.
        library: who writes it.
        compression: of the chunks.

    Attributes:
        registry: its schemas and channels.
        n_chunks: chunks written so far.
    """

    def __init__(self, stream: IO[bytes], library: str, compression: Compression) -> None:
        self._stream = stream
        self._compression = "" if compression == "none" else compression
        self._compress = compressor(compression)
        self.registry = Registry()
        self.n_chunks = 0
        # Serialised, so that a long recording does not hold an object for each of its chunks.
        self._chunks = bytearray()
        self._counts: Counter[int] = Counter()
        self._described: set[int] = set()
        self._times: tuple[int, int] | None = None
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        stream.write(MAGIC)
        self._write(Header(profile="", library=library))

    def write_rows(self, messages: Sequence[Rows], stamps_ns: NDArray[np.int64]) -> None:
        """Add a chunk: at each time a message of every channel named.

        It describes all channels that are registered and have not been described before.

        Args:
            messages: of each channel, T > 0 messages.
            stamps_ns: (T,) both log and publish time, ns since the epoch, rising.

        Raises:
            OSError: the stream cannot be written.
        """
        rows, places = interleaved(messages, stamps_ns)
        starts = rows.shape[1] * np.arange(len(rows))
        index = {channel: (stamps_ns, starts + place) for channel, place in places.items()}
        registered = [channel.id for channel in self.registry.channels.values()]
        self._add_chunk(registered, rows.tobytes(), index)

    def add_chunk(
        self, channel: int, records: bytes, log_times: NDArray[np.int64], places: NDArray[np.int64]
    ) -> None:
        """Add a chunk of one channel's ready message records.

        Args:
            channel: its number in the registry; the first chunk of a channel describes it.
            records: T > 0 messages, as `message_records` makes them.
            log_times: (T,) ns since the epoch.
            places: (T,) where each record begins in `records`.

        Raises:
            OSError: the stream cannot be written.
        """
        self._add_chunk([channel], records, {channel: (log_times, places)})

    def _add_chunk(
        self,
        described: Sequence[int],
        records: bytes,
        places: Mapping[int, tuple[NDArray[np.int64], NDArray[np.int64]]],
    ) -> None:
        """Add a chunk: channels it describes if need be, and by channel (T,) times and places."""
        before = serialised(self._descriptions(described))
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
                uncompressed_crc=crc32(data),
                uncompressed_size=len(data),
            )
        )
        for channel, (log_times, offsets) in places.items():
            index.message_index_offsets[channel] = self._stream.tell()
            index.message_index_length += self._stream.write(
                message_index(channel, log_times, len(before) + offsets)
            )
        self._chunks += serialised([index])
        self.n_chunks += 1
        self._described.update(described)
        self._counts.update({channel: len(times) for channel, (times, _) in places.items()})
        first, last = self._times or (index.message_start_time, index.message_end_time)
        self._times = (
            min(first, index.message_start_time),
            max(last, index.message_end_time),
        )

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file; `time_ns` is when it was there, ns since the epoch.

        Raises:
            OSError: the stream cannot be written.
        """
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
        """Add a metadata record.

        Raises:
            OSError: the stream cannot be written.
        """
        start = self._stream.tell()
        length = self._write(Metadata(name, values))
        self._metadata.append(MetadataIndex(offset=start, length=length, name=name))

    def finish(self) -> None:
        """Write the summary.

        Raises:
            OSError: the stream cannot be written.
        """
        schemas, channels = self.registry.schemas.values(), self.registry.channels.values()
        self._write(DataEnd(data_section_crc=0))
        start = self._stream.tell()
        groups = {
            Opcode.SCHEMA: serialised(schemas),
            Opcode.CHANNEL: serialised(channels),
            Opcode.STATISTICS: serialised([self._statistics()]),
            Opcode.CHUNK_INDEX: bytes(self._chunks),
            Opcode.ATTACHMENT_INDEX: serialised(self._attachments),
            Opcode.METADATA_INDEX: serialised(self._metadata),
        }
        summary, offsets = b"", []
        for opcode, data in groups.items():
            if data:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(data)))
                summary += data
        footer = Footer(start, summary_offset_start=start + len(summary), summary_crc=0)
        summary += serialised(offsets)
        # The checksum goes over the footer too, up to the checksum itself.
        footer.summary_crc = crc32(summary + serialised([footer])[:-4])
        self._stream.write(summary)
        self._write(footer)
        self._stream.write(MAGIC)

    def _descriptions(self, channels: Iterable[int]) -> list[McapRecord]:
        """The records of channels that no chunk has described yet, and of their schemas."""
        found: list[McapRecord] = []
        for number in channels:
            if number not in self._described:
                schema, channel = self.registry.describe(number)
                found += [channel] if schema in found else [schema, channel]
        return found

    def _statistics(self) -> Statistics:
        first, last = self._times or (0, 0)
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self.registry.channels),
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=self.n_chunks,
            message_count=sum(self._counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(self._metadata),
            schema_count=len(self.registry.schemas),
        )

    def _write(self, record: McapRecord) -> int:
        return self._stream.write(serialised([record]))
