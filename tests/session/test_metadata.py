"""Metadata survives the map of strings, and which motion files are attached."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from g1stream.session import metadata
from g1stream.session.metadata import attach_motion, metadata_from_strings, metadata_to_strings

numbers = st.integers() | st.floats(allow_nan=False)
scalars = st.none() | st.booleans() | numbers | st.text()
values = st.recursive(scalars, lambda v: st.lists(v) | st.dictionaries(st.text(), v), max_leaves=9)


@settings(max_examples=40)
@given(st.dictionaries(st.text(), values))
@example({"version": "0.10", "flag": "true", "quoted": '"x"', "nothing": "null", "empty": ""})
def test_any_json_comes_back_as_it_was(data):
    strings = metadata_to_strings(data)
    assert all(isinstance(string, str) for string in strings.values())
    back = metadata_from_strings(strings)
    assert back == data
    assert {k: type(v) for k, v in back.items()} == {k: type(v) for k, v in data.items()}


def test_plain_strings_stay_plain():
    assert metadata_to_strings({"host": "robot-3", "interface": "lo"}) == {
        "host": "robot-3",
        "interface": "lo",
    }


def test_numpy_becomes_numbers_and_lists():
    strings = metadata_to_strings({"kp": np.array([[1.5], [2.0]]), "n": {"at": np.int64(2**60)}})
    assert metadata_from_strings(strings) == {"kp": [[1.5], [2.0]], "n": {"at": 2**60}}


def test_what_json_cannot_say_is_refused():
    with pytest.raises(TypeError, match="set is not JSON"):
        metadata_to_strings({"s": {1}})


class Writer:
    def __init__(self):
        self.attached = []

    def attach(self, *attachment):
        self.attached.append(attachment)


@pytest.mark.parametrize(
    ("name", "kind"),
    [("walk.csv", "text/csv"), ("W.CSV", "text/csv"), ("w.npz", "application/octet-stream")],
)
def test_a_motion_file_is_attached_with_its_type(tmp_path, name, kind):
    (tmp_path / name).write_bytes(b"1,2")
    writer = Writer()
    attach_motion(writer, tmp_path / name, 7)
    assert writer.attached == [(name, kind, b"1,2", 7)]


def test_neither_a_session_nor_a_large_file_nor_a_missing_one_is_attached(tmp_path, monkeypatch):
    monkeypatch.setattr(metadata, "LARGEST_MOTION", 8)
    (tmp_path / "earlier.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "large.csv").write_bytes(bytes(9))
    writer = Writer()
    for source in (None, *(tmp_path / n for n in ("earlier.mcap", "large.csv", "gone.csv", "."))):
        attach_motion(writer, source, 7)
    assert not writer.attached
