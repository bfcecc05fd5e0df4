"""The records of an MCAP: where they are in a file or in a chunk, and their bytes.

The layout is that of the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
from io import BytesIO
from typing import IO, TYPE_CHECKING, Final, NamedTuple

import fastcrc
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from g1stream.input_limits import UNPACKED

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "MAGIC",
    "RECORD_HEAD",
    "Record",
    "content_of",
    "content_size",
    "decompressed",
    "read_at",
    "records_in",
    "records_of",
    "stream_of",
]

MAGIC: Final = b"\x89MCAP0\r\n"
"""The first and the last bytes of a file."""

RECORD_HEAD: Final = struct.Struct("<BQ")
"""Opcode and length of a record; the length counts the bytes that follow."""

#: Of a chunk record: its times, size and checksum of the records in it, and how long the name of
#: their compression is; behind the name are the length of the compressed data and the data.
_CHUNK: Final = struct.Struct("<QQQII")
_LENGTH: Final = struct.Struct("<Q")


class Record(NamedTuple):
    """Where the content of a record is, in bytes from the start of the file or chunk."""

    opcode: int
    start: int
    length: int


def records_of(file: IO[bytes]) -> Iterator[Record]:
    """The whole records of a file, up to its footer or to where it was cut."""
    size = file.seek(0, 2)
    start = len(MAGIC)
    while start + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack(read_at(file, start, RECORD_HEAD.size))
        start += RECORD_HEAD.size
        # A power cut may leave a tail of zeros, and there is no record of that kind.
        if not opcode or start + length > size:
            return
        yield Record(opcode, start, length)
        if opcode == Opcode.FOOTER:
            return
        start += length


def records_in(data: bytes | memoryview) -> Iterator[Record]:
    """The records in a decompressed chunk."""
    start = 0
    while start < len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, start)
        start += RECORD_HEAD.size
        if not opcode or start + length > len(data):
            raise ValueError("a chunk has something else than whole records")
        yield Record(opcode, start, length)
        start += length


def read_at(file: IO[bytes], start: int, size: int) -> bytes:
    """Some bytes of a file, past its buffer, which would be refilled at each skip."""
    return os.pread(file.fileno(), size, start)


def content_of(file: IO[bytes], record: Record) -> bytes:
    """The bytes of a record.

    Raises:
        ValueError: they are too many.
    """
    if record.length > UNPACKED:
        raise ValueError("the record is too large")
    file.seek(record.start)
    return file.read(record.length)


def stream_of(file: IO[bytes], record: Record) -> ReadDataStream:
    """The bytes of a record, as the classes of `mcap.records` read them."""
    return ReadDataStream(BytesIO(content_of(file, record)))


def content_size(file: IO[bytes], chunk: Record) -> int:
    """Bytes of the records in a chunk, as it says."""
    return int(_CHUNK.unpack(read_at(file, chunk.start, _CHUNK.size))[2])


def decompressed(content: bytes | memoryview) -> bytes:
    """The records in a chunk, from the content of its own record."""
    _, _, size, crc, name_length = _CHUNK.unpack_from(content)
    compression = bytes(content[_CHUNK.size :][:name_length])
    data = content[_CHUNK.size + name_length :]
    (data_length,) = _LENGTH.unpack_from(data)
    data = data[_LENGTH.size :][:data_length]
    if size > UNPACKED:
        raise ValueError("the chunk is too large")
    # Neither decompressor may make more than the chunk says: a frame has a size of its own.
    if compression == b"zstd":
        if zstandard.frame_content_size(data) not in (size, -1):
            raise ValueError("a chunk has another size than it says")
        records = zstandard.decompress(data, max_output_size=size)
    elif compression == b"lz4":
        records = LZ4FrameDecompressor().decompress(data, max_length=size)
    elif not compression:
        records = bytes(data)
    else:
        raise ValueError("the compression of a chunk is not known")
    if len(records) != size:
        raise ValueError("a chunk has another size than it says")
    # zlib's crc32, which the library uses, takes half as long as the decompression.
    if crc and fastcrc.crc32.iso_hdlc(records) != crc:
        raise ValueError("the checksum of a chunk does not match")
    return records
