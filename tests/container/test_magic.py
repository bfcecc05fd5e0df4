"""What is an MCAP and what is not."""

import pytest

from g1stream.container.magic import MAGIC, is_mcap


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
