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
from mcap.records import Chunk

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "LARGEST_RECORD",
    "MAGIC",
    "RECORD_HEAD",
    "Record",
    "content_of",
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

LARGEST_RECORD: Final = 512 * 2**20
"""Bytes of a record, and of the content of a chunk.

A few bytes can claim, or decompress to, more than any memory holds. This is far above what g1stream
writes: a chunk has 32 MiB at most, or one scene with meshes.
"""


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


def records_in(data: bytes) -> Iterator[Record]:
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
    if record.length > LARGEST_RECORD:
        raise ValueError("the record is too large")
    file.seek(record.start)
    return file.read(record.length)


def stream_of(file: IO[bytes], record: Record) -> ReadDataStream:
    """The bytes of a record, as the classes of `mcap.records` read them."""
    return ReadDataStream(BytesIO(content_of(file, record)))


def decompressed(content: bytes) -> bytes:
    """The records in a chunk, from the content of its own record."""
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    size = chunk.uncompressed_size
    if size > LARGEST_RECORD:
        raise ValueError("the chunk is too large")
    data: bytes = chunk.data
    # Neither decompressor may make more than the chunk says: a frame has a size of its own.
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(data) not in (size, -1):
            raise ValueError("a chunk has another size than it says")
        data = zstandard.decompress(data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, max_length=size)
    elif chunk.compression:
        raise ValueError("the compression of a chunk is not known")
    if len(data) != size:
        raise ValueError("a chunk has another size than it says")
    # zlib's crc32, which the library uses, takes half as long as the decompression.
    if chunk.uncompressed_crc and fastcrc.crc32.iso_hdlc(data) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk does not match")
    return data
