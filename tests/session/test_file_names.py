"""What the files of a session are called."""

from __future__ import annotations

from pathlib import Path

import pytest

from g1stream.session.file_names import part_number, part_path, parts_of, timestamped

T0 = 1_700_000_000_000_000_000


def test_the_time_in_a_name_is_utc(monkeypatch):
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    assert timestamped("a/s.mcap", T0) == Path("a/s-20231114T221320Z.mcap")


def test_the_parts_of_any_part_are_all_in_their_order(tmp_path):
    parts = [tmp_path / f"s_{number}.mcap" for number in ("001", "002", "010", "999", "1000")]
    for name in ("s_old.mcap", "other_001.mcap", "s_0002.mcap", "s_01.mcap", "s_003.csv"):
        (tmp_path / name).touch()
    for part in reversed(parts):
        part.touch()
    for path in (*parts, tmp_path / "s.mcap"):
        assert parts_of(path) == parts
    assert parts_of(tmp_path / "nowhere.mcap") == [tmp_path / "nowhere.mcap"]
    assert parts_of(tmp_path / "s_old.mcap") == [tmp_path / "s_old.mcap"]
    assert parts_of(tmp_path / "s_0002.mcap") == [tmp_path / "s_0002.mcap"]


def test_a_file_of_the_name_itself_is_alone(tmp_path):
    for name in ("s.mcap", "s_001.mcap"):
        (tmp_path / name).touch()
    assert parts_of(tmp_path / "s.mcap") == [tmp_path / "s.mcap"]


@pytest.mark.parametrize("number", [1, 42, 999, 1000, 20240301])
def test_a_number_comes_back_from_its_name(number):
    assert part_number(part_path(Path("a_7/s.mcap"), number)) == number
