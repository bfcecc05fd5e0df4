"""The records of an MCAP file as bytes: where they are, and the messages in them.

The layouts are those of the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, TYPE_CHECKING, Final, NamedTuple

import fastcrc
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

__all__ = [
    "ChunkPlace",
    "Messages",
    "Record",
    "message_places",
    "messages_at",
    "records",
    "records_in",
    "unpack",
]

_HEAD: Final = struct.Struct("<BQ")
_INDEX_HEAD: Final = struct.Struct("<HI")
_INDEX_ENTRY: Final = np.dtype([("log_time", "<u8"), ("place", "<i8")])
_MESSAGE_HEAD: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)


class Record(NamedTuple):
    """Where the content of a record is, counted in bytes from the start of the file or chunk."""

    opcode: int
    place: int
    length: int


class Messages(NamedTuple):
    """Messages of one channel, in the order of the file.

    Attributes:
        log_times, publish_times: (N,) int64, of each message, ns since the epoch.
        data: of each message.
    """

    log_times: NDArray[np.int64]
    publish_times: NDArray[np.int64]
    data: list[bytes]


@dataclass
class ChunkPlace:
    """Where a chunk is, and the index behind it: by channel, where its entries are and how many.

    A chunk without an index has to be walked through to know what is in it.
    """

    record: Record
    index: dict[int, tuple[int, int]] = field(default_factory=dict)

    def add_index(self, file: IO[bytes], record: Record) -> None:
        """Note a MessageIndex record that follows the chunk.

        Raises:
            ValueError: it is damaged.
        """
        channel, size = _INDEX_HEAD.unpack(_read(file, record.place, _INDEX_HEAD.size))
        n_entries, rest = divmod(size, _INDEX_ENTRY.itemsize)
        if rest or size != record.length - _INDEX_HEAD.size:
            raise ValueError("the index of a chunk has another length than it says")
        if n_entries:
            self.index[channel] = (record.place + _INDEX_HEAD.size, n_entries)

    def places(self, file: IO[bytes], channel: int) -> NDArray[np.int64]:
        """(N,) where in the unpacked chunk the messages of a channel are, as the index says."""
        start, n_entries = self.index[channel]
        entries = np.frombuffer(_read(file, start, n_entries * _INDEX_ENTRY.itemsize), _INDEX_ENTRY)
        return np.sort(entries["place"])


def records(file: IO[bytes]) -> Iterator[Record]:
    """The whole records of a file, up to its footer or to where it was cut."""
    size = file.seek(0, 2)
    place = len(MCAP0_MAGIC)
    while place + _HEAD.size <= size:
        opcode, length = _HEAD.unpack(_read(file, place, _HEAD.size))
        place += _HEAD.size
        # A power cut may leave a tail of zeros, and there is no record of that kind.
        if not opcode or place + length > size:
            return
        yield Record(opcode, place, length)
        if opcode == Opcode.FOOTER:
            return
        place += length


def _read(file: IO[bytes], place: int, size: int) -> bytes:
    """Some bytes of a file; past its buffer, which would be filled anew at each leap."""
    return os.pread(file.fileno(), size, place)


def unpack(content: bytes) -> bytes:
    """The records in a chunk, from the content of its own record.

    Raises:
        ValueError: they do not have the checksum that they should; or whatever their compression
            raises.
    """
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    stream, size = get_chunk_data_stream(chunk)
    data = stream.read(size)
    # zlib's own crc32, which the stock reader uses, takes half as long as the decompression.
    if chunk.uncompressed_crc and fastcrc.crc32.iso_hdlc(data) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk does not fit")
    return data


def records_in(data: bytes) -> Iterator[Record]:
    """The records in an unpacked chunk."""
    place = 0
    while place < len(data):
        opcode, length = _HEAD.unpack_from(data, place)
        place += _HEAD.size
        yield Record(opcode, place, length)
        place += length


def message_places(data: bytes) -> dict[int, NDArray[np.int64]]:
    """By channel, (N,) where in an unpacked chunk its messages are, without an index."""
    found: dict[int, list[int]] = {}
    for record in records_in(data):
        if record.opcode == Opcode.MESSAGE:
            channel = int.from_bytes(data[record.place : record.place + 2], "little")
            found.setdefault(channel, []).append(record.place - _HEAD.size)
    return {channel: np.array(places, dtype=np.int64) for channel, places in found.items()}


def messages_at(data: bytes, places: NDArray[np.int64], channel: int) -> Messages:
    """The messages of a channel in an unpacked chunk, from where they are (N,).

    Raises:
        ValueError: one of them is not there.
    """
    size, head = len(data), _MESSAGE_HEAD.itemsize
    if ((places < 0) | (places + head > size)).any():
        raise ValueError("the index of a chunk points outside of it")
    octets = np.frombuffer(data, np.uint8)
    heads = octets[places[:, np.newaxis] + np.arange(head)].view(_MESSAGE_HEAD)[:, 0]
    ends = places + _HEAD.size + np.clip(heads["length"], 0, size)
    wrong = (heads["opcode"] != Opcode.MESSAGE) | (heads["channel"] != channel)
    if (wrong | (ends < places + head) | (ends > size)).any():
        raise ValueError("the index of a chunk points to something else than a message")
    bounds = zip((places + head).tolist(), ends.tolist(), strict=True)
    return Messages(
        np.ascontiguousarray(heads["log_time"]),
        np.ascontiguousarray(heads["publish_time"]),
        [data[start:end] for start, end in bounds],
    )
