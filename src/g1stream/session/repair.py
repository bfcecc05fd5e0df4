"""Writes the index of a session file whose recorder was killed, as viewers need it.

The records of the file are copied as they are, and the summary that its recorder would have written
follows them. The original is replaced when its copy is complete.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import struct
import zlib
from collections import deque
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from g1stream.errors import RecordingError
from g1stream.files import complete_file
from g1stream.session.format import CHANNELS
from g1stream.session.mcap_reader import (
    MAGIC,
    RECORD_HEAD,
    McapFile,
    content_of,
    decompressed,
    records_in,
    records_of,
    stream_of,
)
from g1stream.session.parts import Part, parts_of, write_metadata_yaml

if TYPE_CHECKING:
    from mcap.records import McapRecord

    from g1stream.session.mcap_reader import RecordSpan

__all__ = ["Repair", "repair_session"]

#: Of a Message record: channel, sequence and log time.
_MESSAGE: Final = struct.Struct("<HIQ")


class Repair(NamedTuple):
    """What was done to a file.

    Attributes:
        path: of the file.
        messages: in the file.
        dropped: bytes at its end that were no whole record; None if it had its index already.
    """

    path: Path
    messages: int
    dropped: int | None


def repair_session(path: Path) -> list[Repair]:
    """Write the index of a session's files, where it is missing.

    Args:
        path: of a session file, or of the directory of a split recording; files in it that are
            absent or cannot be read stay as they are.

    Returns:
        What was done, file by file.

    Raises:
        RecordingError: a file is no session, damaged, still being recorded, or cannot be written.
            It is then unchanged.
    """
    files = parts_of(path)
    if files == [path]:
        return [_repair_file(path)]
    done, parts = [], []
    for file in files:
        if file.is_file():
            done.append(_repair_file(file))
            parts.append(_part(file))
        else:
            parts.append(Part(file.name, {}, None, None))
    if any(one.dropped is not None for one in done):
        write_metadata_yaml(path, parts, CHANNELS)
    return done


def _repair_file(path: Path) -> Repair:
    source = McapFile(path)
    messages = source.counts.total()
    with path.open("rb") as file:
        _lock(file, path)
        last = next(iter(deque(records_of(file), maxlen=1)), None)
        if last and last.opcode == Opcode.FOOTER:
            with source.damage_at(last):
                if Footer.read(stream_of(file, last)).summary_start:
                    return Repair(path, messages, None)
        size = os.fstat(file.fileno()).st_size
        end = size if source.complete else last.start + last.length if last else len(MAGIC)
        with complete_file(path) as temporary, temporary.open("wb") as output:
            shutil.copymode(path, temporary)
            _Copy(output).copy(source, file)
            output.flush()
            os.fsync(output.fileno())
        return Repair(path, messages, size - end)


def _lock(file: IO[bytes], path: Path) -> None:
    """Check that no recorder has the file open: it holds a lock until it ends."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise RecordingError(
            f"{path} is still being recorded.", "Repair it when its recorder has ended."
        ) from error
    except OSError:  # a file system without locks
        return


def _part(path: Path) -> Part:
    with path.open("rb") as file:
        about = next(r for r in records_of(file) if r.opcode == Opcode.STATISTICS)
        statistics = Statistics.read(stream_of(file, about))
    times = statistics.message_start_time, statistics.message_end_time
    return Part(
        path.name, McapFile(path).counts, *(times if statistics.message_count else (None,) * 2)
    )


class _Copy:
    """A copy of a file's records, with what its summary says of them.

    Args:
        output: the new file.
    """

    def __init__(self, output: IO[bytes]) -> None:
        self._output = output
        self._schemas: dict[int, McapRecord] = {}
        self._channels: dict[int, McapRecord] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[McapRecord] = []
        self._metadata: list[McapRecord] = []
        self._counts: dict[int, int] = {}

    def copy(self, source: McapFile, file: IO[bytes]) -> None:
        """Copy the records up to the end of the data, and write the summary."""
        self._output.write(MAGIC)
        for record in records_of(file):
            if record.opcode == Opcode.DATA_END:
                break
            # The index of the last chunk may be cut, so each is made anew.
            if record.opcode != Opcode.MESSAGE_INDEX:
                with source.damage_at(record):
                    self._add(record, content_of(file, record))
        self._finish()

    def _add(self, record: RecordSpan, content: bytes) -> None:
        place = self._output.tell()
        self._output.write(RECORD_HEAD.pack(record.opcode, record.length))
        self._output.write(content)
        length = self._output.tell() - place
        stream = ReadDataStream(BytesIO(content))
        if record.opcode == Opcode.CHUNK:
            self._index(Chunk.read(stream), decompressed(content), place, length)
        elif record.opcode == Opcode.ATTACHMENT:
            one = Attachment.read(stream)
            about = one.log_time, one.create_time, len(one.data), one.name, one.media_type
            self._attachments.append(AttachmentIndex(place, length, *about))
        elif record.opcode == Opcode.METADATA:
            self._metadata.append(MetadataIndex(place, length, Metadata.read(stream).name))
        else:
            self._describe(record.opcode, content)

    def _describe(self, opcode: int, content: bytes) -> None:
        """Note a schema or a channel."""
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            self._channels[channel.id] = channel

    def _index(self, chunk: Chunk, data: bytes, place: int, length: int) -> None:
        """Write the index of a chunk's messages behind it."""
        entries: dict[int, list[tuple[int, int]]] = {}
        for record in records_in(data):
            if record.opcode == Opcode.MESSAGE:
                channel, _, log_time = _MESSAGE.unpack_from(data, record.start)
                entries.setdefault(channel, []).append((log_time, record.start - RECORD_HEAD.size))
            else:
                self._describe(record.opcode, data[record.start : record.start + record.length])
        start, offsets = self._output.tell(), {}
        builder: Any = RecordBuilder()
        for channel, found in entries.items():
            offsets[channel] = start + builder.count
            MessageIndex(channel, found).write(builder)
            self._counts[channel] = self._counts.get(channel, 0) + len(found)
        self._output.write(builder.end())
        self._chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=place,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=self._output.tell() - start,
                message_index_offsets=offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def _finish(self) -> None:
        """Write the end of the data, the summary and the footer."""
        filled = [chunk for chunk in self._chunks if chunk.message_index_offsets]
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in filled), default=0),
            message_start_time=min((chunk.message_start_time for chunk in filled), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        builder: Any = RecordBuilder()
        DataEnd(0).write(builder)  # 0: no checksum
        self._output.write(builder.end())
        start = self._output.tell()
        offsets = []
        for opcode, group in (
            (Opcode.SCHEMA, self._schemas.values()),
            (Opcode.CHANNEL, self._channels.values()),
            (Opcode.STATISTICS, (statistics,)),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            first = builder.count
            for record in group:
                record.write(builder)
            if builder.count > first:
                offsets.append(SummaryOffset(opcode, start + first, builder.count - first))
        offsets_start = start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = builder.end()
        # The checksum includes the footer up to itself.
        footer = RECORD_HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, offsets_start)
        Footer(start, offsets_start, zlib.crc32(summary + footer)).write(builder)
        self._output.write(summary + builder.end() + MAGIC)
