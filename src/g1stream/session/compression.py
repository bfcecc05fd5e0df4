"""What a chunk holds, packed and unpacked."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Final, Literal

import fastcrc
from mcap.data_stream import ReadDataStream
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Compression", "compressor", "crc32", "unpack"]

Compression = Literal["zstd", "lz4", "none"]

crc32: Final = fastcrc.crc32.iso_hdlc
"""CRC-32 as zlib has it, an order of magnitude faster."""


def compressor(compression: Compression) -> Callable[[bytes], bytes]:
    """What packs the records of a chunk."""
    if compression == "zstd":
        import zstandard

        # The doubles of a motion are noise to a compressor: level 3 takes longer and gains nothing.
        return zstandard.ZstdCompressor(level=1).compress
    if compression == "lz4":
        import lz4.frame

        compress: Callable[[bytes], bytes] = lz4.frame.compress
        return compress
    return bytes


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
    if chunk.uncompressed_crc and crc32(data) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk does not fit")
    return data
