"""The tables: complete at any time, newest rows first, one writer."""

from __future__ import annotations

import numpy as np
import pytest

import g1stream
from g1stream.errors import RecordingError
from g1stream.extras.library import table
from g1stream.extras.library.table import (
    CONDITION_NAMES,
    JointRow,
    MotionRow,
    Rows,
    condition_value,
    open_library,
    writing,
)


def rows(name="wave", key="1", **values):
    motion = MotionRow(key=key, name=name, path=f"{name}.csv", sha256=name, command="check")
    motion = motion.model_copy(update=values)
    joints = [JointRow(key=key, joint=joint, rmse=0.5) for joint in ("left_knee_joint", "waist")]
    return Rows(motion=motion, joints=joints)


def test_rows_are_read_while_they_are_written(tmp_path):
    with writing(tmp_path) as writer:
        writer.add([rows("wave", "1", max_tilt=0.25)])
        first = open_library(tmp_path)
        writer.add([rows("walk", "2"), rows("jump", "3", status="broken", reason="no")])
        assert list(open_library(tmp_path).motions["name"]) == ["wave", "walk", "jump"]
    assert list(first.motions["max_tilt"]) == [0.25]
    library = open_library(tmp_path)
    assert len(list((tmp_path / "motions").iterdir())) == 1
    assert list(library.motions["status"]) == ["ok", "ok", "broken"]
    assert list(library.joints["key"]) == ["1", "1", "2", "2", "3", "3"]
    assert library.motions["frames"].isna().all()


def test_a_newer_row_replaces_an_older_one(tmp_path):
    with writing(tmp_path) as writer:
        writer.add([rows(key="old", max_tilt=0.1), rows("walk", "2")])
        writer.add([rows(key="new", max_tilt=0.2)])
    library = open_library(tmp_path)
    assert dict(zip(library.motions["name"], library.motions["max_tilt"], strict=True)) == {
        "walk": pytest.approx(np.nan, nan_ok=True),
        "wave": 0.2,
    }
    assert set(library.joints["key"]) == {"new", "2"}


def test_many_parts_become_one(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "_MOST_PARTS", 4)
    with writing(tmp_path) as writer:
        for i in range(10):
            writer.add([rows(f"motion {i}", str(i))])
            assert len(list((tmp_path / "motions").glob("part-*"))) <= 4
    assert list(open_library(tmp_path).motions["key"]) == [str(i) for i in range(10)]


def test_a_condition_takes_numbers_and_answers():
    row = {"frames": 30, "free": "inexact", "rmse": np.nan, "success": True}
    assert {*row} < {*CONDITION_NAMES}
    others = {"status": "ok", "feet": "false"}  # as an older version wrote it
    found = {name: condition_value(row | others, name) for name in ("ok", *row)}
    assert found == {"ok": 1.0, "frames": 30.0, "free": 0.5, "rmse": None, "success": 1.0}


def test_what_need_not_be_computed(tmp_path):
    with writing(tmp_path) as writer:
        writer.add([rows(key="ok"), rows("b", "broken", status="broken")])
        writer.add([rows("c", "slow", status="slow", limits="1 s, 10 MB")])
        writer.add([rows("d", "error", status="error")])
    with writing(tmp_path) as writer:
        assert writer.has("ok", "5 s, 10 MB")
        assert writer.has("broken", "5 s, 10 MB")
        assert writer.has("slow", "1 s, 10 MB")
        assert not writer.has("slow", "5 s, 10 MB")
        assert not writer.has("error", "1 s, 10 MB")
        assert not writer.has("unknown", "1 s, 10 MB")


def test_what_a_killed_writer_left_is_removed(tmp_path):
    with writing(tmp_path) as writer:
        writer.add([rows()])
    left = tmp_path / "motions" / ".part-000009.parquet.123.part"
    left.write_bytes(b"PAR1")
    with writing(tmp_path):
        assert not left.exists()
    assert len(open_library(tmp_path).motions) == 1


def test_there_is_one_writer(tmp_path):
    with writing(tmp_path), pytest.raises(RecordingError), writing(tmp_path):
        pass


def test_no_library_and_a_damaged_one(tmp_path):
    with pytest.raises(RecordingError):
        open_library(tmp_path)
    with writing(tmp_path) as writer:
        writer.add([rows()])
    (part,) = (tmp_path / "motions").glob("*.parquet")
    part.write_bytes(part.read_bytes()[:100])
    with pytest.raises(RecordingError):
        g1stream.open_library(tmp_path)
