"""Chunks packed by us and unpacked by the stock reader, and the other way about."""

from __future__ import annotations

import zlib

import pytest
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream

from g1stream.session.compression import compressor, crc32, unpack
from g1stream.session.records import RECORD_HEAD, serialised

DATA = b"some of it again and again " * 400


def chunk_of(compression, data=DATA, crc=None):
    return Chunk(
        compression="" if compression == "none" else compression,
        data=compressor(compression)(data),
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=zlib.crc32(data) if crc is None else crc,
        uncompressed_size=len(data),
    )


def content_of(chunk):
    return serialised([chunk])[RECORD_HEAD.size :]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("data", [DATA, b""])
def test_what_is_packed_comes_back_by_the_stock_reader_and_by_ours(compression, data):
    chunk = chunk_of(compression, data)
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    assert stream.read(size) == data
    assert unpack(content_of(chunk)) == data


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_it_takes_less_room(compression):
    assert len(compressor(compression)(DATA)) < len(DATA) / 10


def test_a_checksum_that_does_not_fit_is_noticed_and_none_is_none():
    with pytest.raises(ValueError, match="checksum"):
        unpack(content_of(chunk_of("zstd", crc=zlib.crc32(DATA) ^ 1)))
    assert unpack(content_of(chunk_of("zstd", crc=0))) == DATA


def test_the_checksum_is_that_of_zlib():
    assert crc32(DATA) == zlib.crc32(DATA)
