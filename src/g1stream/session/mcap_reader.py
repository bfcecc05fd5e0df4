"""Reads MCAP files, whole ones and ones whose writer was killed.

The stock readers want either the index at the end of the file or a message object per message. This
one needs neither: it hops from record to record to find the chunks, stops at the first that is not
whole, and unpacks only the chunks in which a wanted topic has messages.
"""

from __future__ import annotations

import stat
from collections import Counter
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Statistics

from g1stream.errors import RecordingError
from g1stream.session.compression import unpack
from g1stream.session.magic import MAGIC
from g1stream.session.message_index import ChunkPlace
from g1stream.session.message_records import message_places, messages_at
from g1stream.session.prefetch import ahead
from g1stream.session.records import records, records_in

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable, Iterator

    from g1stream.session.records import Record
    from g1stream.session.source import Messages

__all__ = ["McapFile"]


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

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.complete = False
        self.counts: Counter[str] = Counter()
        self.metadata: list[Metadata] = []
        self._topics: dict[int, str] = {}
        self._chunks: list[ChunkPlace] = []
        self._attachments: list[Record] = []
        self._statistics: Statistics | None = None
        with self._open() as file:
            last = None
            for last in records(file):
                with self._unpacking(last):
                    self._take(file, last)
            # Of the last chunk of a file cut short, a part of the index may be missing.
            if last and last.opcode in {Opcode.CHUNK, Opcode.MESSAGE_INDEX}:
                self._chunks[-1].index.clear()
            for channel, count in self._count(file).items():
                self.counts[self._topic(channel)] += count

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, one batch per channel and chunk, in the order of the file.

        Raises:
            RecordingError: a chunk is damaged.
        """
        channels = {channel for channel, topic in self._topics.items() if topic in topics}
        chunks = [c for c in self._chunks if not c.index or not channels.isdisjoint(c.index)]
        with self._open() as file:
            for chunk, data in zip(chunks, self._unpacked(file, chunks), strict=True):
                with self._unpacking(chunk.record):
                    found = _messages(file, chunk, data, channels)
                for channel, messages in found.items():
                    yield self._topic(channel), messages

    def attachments(self) -> Iterator[Attachment]:
        """The attached files, oldest first."""
        with self._open() as file:
            for record in self._attachments:
                with self._unpacking(record):
                    attachment = Attachment.read(_stream(file, record))
                yield attachment

    def _open(self) -> IO[bytes]:
        try:
            mode = self.path.stat().st_mode
            if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                # To open a pipe may take for ever, and one cannot go back in it.
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
            raise RecordingError(f"{self.path} {what}.", "Give an MCAP file.")
        return file

    def _take(self, file: IO[bytes], record: Record) -> None:
        """Note what a record outside the chunks says."""
        if record.opcode == Opcode.CHUNK:
            self._chunks.append(ChunkPlace(record))
        elif record.opcode == Opcode.MESSAGE_INDEX:
            self._chunks[-1].add_index(file, record)
        elif record.opcode == Opcode.ATTACHMENT:
            self._attachments.append(record)
        elif record.opcode == Opcode.METADATA:
            self.metadata.append(Metadata.read(_stream(file, record)))
        elif record.opcode == Opcode.CHANNEL:
            self._add_channel(_stream(file, record))
        elif record.opcode == Opcode.STATISTICS:
            self._statistics = Statistics.read(_stream(file, record))
        elif record.opcode == Opcode.FOOTER:
            self.complete = True

    def _count(self, file: IO[bytes]) -> Counter[int]:
        """Messages of each channel; a file cut short is asked chunk by chunk."""
        if self._statistics:
            return Counter(self._statistics.channel_message_counts)
        counts: Counter[int] = Counter()
        for number, chunk in enumerate(self._chunks):
            found = {channel: n for channel, (_, n) in chunk.index.items()}
            found = found or self._walk(file, chunk)
            counts.update(found)
            for channel in found.keys() - self._topics.keys():
                self._look_for_name(file, channel, number)
        return counts

    def _look_for_name(self, file: IO[bytes], channel: int, number: int) -> None:
        """Read what a channel is called.

        That is written where its first message was to come: in the chunk of that number, or in one
        before that was closed because of it.
        """
        for chunk in reversed(self._chunks[: number + 1]):
            self._walk(file, chunk)
            if channel in self._topics:
                return
        self._topics[channel] = f"channel {channel}"

    def _walk(self, file: IO[bytes], chunk: ChunkPlace) -> dict[int, int]:
        """Note the channels that a chunk describes, and count its messages by channel."""
        (data,) = self._unpacked(file, [chunk])
        with self._unpacking(chunk.record):
            for opcode, place, length in records_in(data):
                if opcode == Opcode.CHANNEL:
                    self._add_channel(ReadDataStream(BytesIO(data[place : place + length])))
            return {channel: len(places) for channel, places in message_places(data).items()}

    def _unpacked(self, file: IO[bytes], chunks: Iterable[ChunkPlace]) -> Iterator[bytes]:
        """The records of each chunk, unpacked a few chunks ahead."""

        def unpacked(packed: tuple[Record, bytes]) -> bytes:
            with self._unpacking(packed[0]):
                return unpack(packed[1])

        return ahead(unpacked, ((c.record, _content(file, c.record)) for c in chunks))

    @contextmanager
    def _unpacking(self, record: Record) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # every field and each compression has an error of its own
            raise RecordingError(
                f"The file {self.path} is damaged: what is at byte {record.place} does not unpack.",
                "Save the rest of it with a tool such as `mcap recover`.",
            ) from error

    def _topic(self, channel_id: int) -> str:
        return self._topics.get(channel_id, f"channel {channel_id}")

    def _add_channel(self, stream: ReadDataStream) -> None:
        channel = Channel.read(stream)
        self._topics[channel.id] = channel.topic


def _content(file: IO[bytes], record: Record) -> bytes:
    file.seek(record.place)
    return file.read(record.length)


def _stream(file: IO[bytes], record: Record) -> ReadDataStream:
    return ReadDataStream(BytesIO(_content(file, record)))


def _messages(
    file: IO[bytes], chunk: ChunkPlace, data: bytes, channels: set[int]
) -> dict[int, Messages]:
    """By channel, the messages of an unpacked chunk."""
    if chunk.index:
        places = {c: chunk.places(file, c) for c in sorted(channels & chunk.index.keys())}
    else:
        places = {c: found for c, found in message_places(data).items() if c in channels}
    return {channel: messages_at(data, where, channel) for channel, where in places.items()}
