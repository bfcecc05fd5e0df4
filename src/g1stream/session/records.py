"""The records of an MCAP as bytes: an opcode, a length and so many bytes, one behind the other.

The layouts here and beside are those of the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from g1stream.session.magic import MAGIC

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mcap.records import McapRecord

__all__ = ["RECORD_HEAD", "Record", "read_at", "records", "records_in", "serialised"]

RECORD_HEAD: Final = struct.Struct("<BQ")
"""Opcode and length of a record; the length counts what is behind them."""


class Record(NamedTuple):
    """Where the content of a record is, counted in bytes from the start of the file or chunk."""

    opcode: int
    place: int
    length: int


def records(file: IO[bytes]) -> Iterator[Record]:
    """The whole records of a file, up to its footer or to where it was cut."""
    size = file.seek(0, 2)
    place = len(MAGIC)
    while place + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack(read_at(file, place, RECORD_HEAD.size))
        place += RECORD_HEAD.size
        # A power cut may leave a tail of zeros, and there is no record of that kind.
        if not opcode or place + length > size:
            return
        yield Record(opcode, place, length)
        if opcode == Opcode.FOOTER:
            return
        place += length


def records_in(data: bytes) -> Iterator[Record]:
    """The records in an unpacked chunk."""
    place = 0
    while place < len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, place)
        place += RECORD_HEAD.size
        yield Record(opcode, place, length)
        place += length


def read_at(file: IO[bytes], place: int, size: int) -> bytes:
    """Some bytes of a file; past its buffer, which would be filled anew at each leap."""
    return os.pread(file.fileno(), size, place)


def serialised(records: Iterable[McapRecord]) -> bytes:
    """Records of mcap's own as the bytes of a file."""
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()
    return data
