"""Records as bytes: walked in a file and in a chunk, up to where they end or were cut."""

from __future__ import annotations

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, Header, Metadata

from g1stream.session.magic import MAGIC
from g1stream.session.records import RECORD_HEAD, read_at, records, records_in, serialised

SOME = [Header("", "tests"), Metadata("a", {"b": "c"}), DataEnd(0)]
OPCODES = [Opcode.HEADER, Opcode.METADATA, Opcode.DATA_END]


def walked(path, content):
    path.write_bytes(content)
    with path.open("rb") as file:
        return list(records(file))


def test_they_are_serialised_as_the_stock_writer_does():
    builder = RecordBuilder()
    for record in SOME:
        record.write(builder)
    assert serialised(SOME) == builder.end()
    assert serialised([]) == b""


def test_each_is_found_with_its_content(tmp_path):
    content = MAGIC + serialised(SOME)
    found = walked(tmp_path / "f", content)
    assert [record.opcode for record in found] == OPCODES
    for record, one in zip(found, SOME, strict=True):
        whole = serialised([one])
        assert content[record.place : record.place + record.length] == whole[RECORD_HEAD.size :]
    inside = records_in(content[len(MAGIC) :])
    assert [(r.opcode, r.place + len(MAGIC), r.length) for r in inside] == found


def test_nothing_is_looked_for_behind_the_footer(tmp_path):
    content = MAGIC + serialised([*SOME, Footer(0, 0, 0), *SOME])
    assert [record.opcode for record in walked(tmp_path / "f", content)] == [
        *OPCODES,
        Opcode.FOOTER,
    ]


@pytest.mark.parametrize("tail", [b"", bytes(3), bytes(4096)])
def test_a_record_that_is_cut_ends_them_and_zeros_are_none(tmp_path, tail):
    whole = MAGIC + serialised(SOME[:2])
    last = serialised(SOME[2:])
    assert len(walked(tmp_path / "f", whole + tail)) == 2
    for cut in range(len(last)):
        assert len(walked(tmp_path / "f", whole + last[:cut])) == 2


def test_bytes_are_read_where_they_are_wherever_the_file_is_at(tmp_path):
    (tmp_path / "f").write_bytes(b"0123456789")
    with (tmp_path / "f").open("rb") as file:
        file.seek(8)
        assert read_at(file, 2, 3) == b"234"
        assert file.tell() == 8
