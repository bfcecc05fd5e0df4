"""Reads MCAP files, whole ones and ones whose writer was killed.

The stock readers want either an index or a message object per message. This one needs neither: it
hops from record to record to find the chunks, stops at the first that is not whole, and takes the
messages of a chunk out of its bytes.
"""

from __future__ import annotations

import struct
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Statistics
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from g1stream.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["McapFile", "Messages"]

_RECORD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")


@dataclass
class Messages:
    """Messages of one topic, in the order of the file.

    Attributes:
        log_times, publish_times: of each message, ns since the epoch.
        data: of each message.
    """

    log_times: list[int] = field(default_factory=list)
    publish_times: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


class McapFile:
    """The chunked messages, metadata and attachments of an MCAP file.

    Attributes:
        path: of the file.
        complete: whether it was closed properly.
        counts: messages of each topic.
        metadata: its metadata records, oldest first.

    Raises:
        RecordingError: there is no such file, or it is not an MCAP, or it is damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.complete = False
        self.counts: Counter[str] = Counter()
        self.metadata: list[Metadata] = []
        self._topics: dict[int, str] = {}
        self._chunks: list[int] = []
        self._attachments: list[int] = []
        self._statistics: Statistics | None = None
        with self._open() as file:
            for opcode, place in _records(file):
                with self._unpacking(place):
                    self._take(opcode, place, ReadDataStream(file))
        counts = self._statistics.channel_message_counts if self._statistics else self._count()
        for channel, count in counts.items():
            self.counts[self._topic(channel)] += count

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, one batch per topic and chunk, in the order of the file.

        Raises:
            RecordingError: a chunk is damaged.
        """
        with self._open() as file:
            for place in self._chunks:
                data = self._chunk(file, place)
                found: dict[str, Messages] = {}
                for channel, log_time, publish_time, start, end in self._messages(data):
                    topic = self._topic(channel)
                    if topic in topics:
                        batch = found.setdefault(topic, Messages())
                        batch.log_times.append(log_time)
                        batch.publish_times.append(publish_time)
                        batch.data.append(data[start:end])
                yield from found.items()

    def attachments(self) -> Iterator[Attachment]:
        """The attached files, oldest first."""
        with self._open() as file:
            for place in self._attachments:
                file.seek(place)
                with self._unpacking(place):
                    attachment = Attachment.read(ReadDataStream(file))
                yield attachment

    def _open(self) -> IO[bytes]:
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise RecordingError(
                f"The recording {self.path} cannot be read: {error.strerror}.",
                "Check the path given.",
            ) from error
        magic = file.read(len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC:
            file.close()
            what = "is not an MCAP file" if magic else "is empty"
            raise RecordingError(f"{self.path} {what}.", "Give a file that g1stream recorded.")
        return file

    def _count(self) -> Counter[int]:
        """Messages of each channel, counted one by one: a file cut short has no statistics."""
        counts: Counter[int] = Counter()
        with self._open() as file:
            for place in self._chunks:
                counts.update(m[0] for m in self._messages(self._chunk(file, place)))
        return counts

    def _take(self, opcode: int, place: int, stream: ReadDataStream) -> None:
        """Note what a record outside the chunks says."""
        if opcode == Opcode.CHUNK:
            self._chunks.append(place)
        elif opcode == Opcode.ATTACHMENT:
            self._attachments.append(place)
        elif opcode == Opcode.METADATA:
            self.metadata.append(Metadata.read(stream))
        elif opcode == Opcode.CHANNEL:
            self._add_channel(stream)
        elif opcode == Opcode.STATISTICS:
            self._statistics = Statistics.read(stream)
        elif opcode == Opcode.FOOTER:
            self.complete = True

    def _chunk(self, file: IO[bytes], place: int) -> bytes:
        file.seek(place)
        with self._unpacking(place):
            chunk = Chunk.read(ReadDataStream(file))
            stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        return stream.read(size)

    def _messages(self, data: bytes) -> Iterator[tuple[int, int, int, int, int]]:
        """Channel, log time, publish time, start and end of data of each message in a chunk."""
        place = 0
        while place < len(data):
            opcode, length = _RECORD.unpack_from(data, place)
            place += _RECORD.size
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, publish_time = _MESSAGE.unpack_from(data, place)
                yield channel, log_time, publish_time, place + _MESSAGE.size, place + length
            elif opcode == Opcode.CHANNEL:
                self._add_channel(ReadDataStream(BytesIO(data[place : place + length])))
            place += length

    @contextmanager
    def _unpacking(self, place: int) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # every field and each compression has an error of its own
            raise RecordingError(
                f"The recording {self.path} is damaged: what is at byte {place} does not unpack.",
                "Save the rest of it with a tool such as `mcap recover`.",
            ) from error

    def _topic(self, channel_id: int) -> str:
        return self._topics.get(channel_id, f"channel {channel_id}")

    def _add_channel(self, stream: ReadDataStream) -> None:
        channel = Channel.read(stream)
        self._topics[channel.id] = channel.topic


def _records(file: IO[bytes]) -> Iterator[tuple[int, int]]:
    """Opcode and place of the content of each whole record, with the file at that place."""
    size = file.seek(0, 2)
    place = len(MCAP0_MAGIC)
    while place + _RECORD.size <= size:
        file.seek(place)
        opcode, length = _RECORD.unpack(file.read(_RECORD.size))
        place += _RECORD.size
        if place + length > size:
            return
        yield opcode, place
        if opcode == Opcode.FOOTER:
            return
        place += length
