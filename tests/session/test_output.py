"""The file under a recording: whole pieces or none."""

from __future__ import annotations

import pytest

from g1stream.session.output import Output


def test_a_piece_that_fails_is_taken_back(tmp_path):
    output = Output(tmp_path / "x", "x")
    output.write(b"whole")
    output.settle()
    output.write(b"half")
    output.take_back()
    output.write(b"!")
    output.close()
    assert (tmp_path / "x").read_bytes() == b"whole!"


def test_what_is_there_is_replaced_only_when_told_to(tmp_path):
    (tmp_path / "x").write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        Output(tmp_path / "x", "x")
    assert (tmp_path / "x").read_bytes() == b"precious"
    Output(tmp_path / "x", "w").close()
    assert (tmp_path / "x").read_bytes() == b""
