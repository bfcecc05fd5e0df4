"""What is an MCAP and what is not."""

import os

import pytest

from g1stream.session.magic import MAGIC, is_blank, is_mcap


@pytest.mark.parametrize(
    ("content", "answer"),
    [(MAGIC, True), (b"\x89MCAP1\r\n", True), (b"", False), (b"Frame,X", False)],
)
def test_a_file_is_known_by_its_first_bytes(tmp_path, content, answer):
    (tmp_path / "f").write_bytes(content)
    assert is_mcap(tmp_path / "f") is answer


def test_what_cannot_be_read_is_none(tmp_path):
    assert not is_mcap(tmp_path)
    assert not is_mcap(tmp_path / "nowhere")


def test_nothing_is_taken_from_a_pipe(tmp_path):
    # Opened, one without a writer would be waited for.
    os.mkfifo(tmp_path / "pipe")
    assert not is_mcap(tmp_path / "pipe")
    assert not is_blank(tmp_path / "pipe")


@pytest.mark.parametrize(
    ("content", "answer"),
    [
        (b"", True),
        (bytes(10), True),
        (bytes(3 << 20), True),
        (MAGIC, False),
        (bytes(2 << 20) + b"x", False),
    ],
)
def test_a_blank_file_is_empty_or_zeros(tmp_path, content, answer):
    (tmp_path / "f").write_bytes(content)
    assert is_blank(tmp_path / "f") is answer


def test_what_is_not_there_or_no_file_is_not_blank(tmp_path):
    assert not is_blank(tmp_path)
    assert not is_blank(tmp_path / "nowhere")
