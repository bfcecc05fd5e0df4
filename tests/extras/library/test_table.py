import numpy as np
import pandas as pd
import pytest
from pyarrow import parquet

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


def rows(name="wave", key="1", sweep=None, **values):
    motion = MotionRow(key=key, name=name, path=f"{name}.csv", sha256=name, command="check")
    motion = motion.model_copy(update=values)
    joints = [JointRow(key=key, joint=joint, rmse=0.5) for joint in ("left_knee_joint", "waist")]
    return Rows(motion=motion, joints=joints, sweep=sweep or {})


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


def test_what_a_killed_process_left_is_removed_and_other_files_are_kept(tmp_path):
    with writing(tmp_path) as writer:
        writer.add([rows()])
    left = [tmp_path / name / ".part-000009.parquet.part" for name in ("motions", "joints")]
    other = tmp_path / "motions" / "notes.txt"
    for path in (*left, other):
        path.write_bytes(b"half a table")
    with writing(tmp_path) as writer:
        writer.add([rows("walk", "2")])
    assert not [path for path in left if path.exists()]
    assert other.exists()
    assert sorted(open_library(tmp_path).motions["name"]) == ["walk", "wave"]


def test_a_newer_row_replaces_an_older_one(tmp_path):
    with writing(tmp_path) as writer:
        writer.add([rows(key="old", max_tilt=0.1), rows("walk", "2")])
        writer.add([rows(key="new", max_tilt=0.2)])
    library = open_library(tmp_path)
    assert dict(zip(library.motions["name"], library.motions["key"], strict=True)) == {
        "walk": "2",
        "wave": "new",
    }
    assert set(library.joints["key"]) == {"new", "2"}


def test_sweeps_have_columns_of_their_own(tmp_path):
    with writing(tmp_path) as writer:
        writer.add([rows()])
        swept = {"gains.kp": 0.5, "stream.feedforward": "none"}
        writer.add([rows(key="2", sweep=swept, variant="gains.kp=0.5")])
    motions = open_library(tmp_path).motions
    assert motions["gains.kp"].isna().tolist() == [True, False]
    assert motions["stream.feedforward"].iloc[1] == "none"


def test_small_parts_become_one(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "_MOST_PARTS", 3)
    monkeypatch.setattr(table, "_SMALL", 2)
    with writing(tmp_path) as writer:
        for i in range(5):
            writer.add([rows(f"{name} {i}", f"{name} {i}") for name in ("wave", "walk")])
        for i in range(7):
            writer.add([rows(f"motion {i}", str(i))])
            assert len(list((tmp_path / "motions").glob("part-*"))) <= 5 + 3
    keys = [f"{name} {i}" for i in range(5) for name in ("wave", "walk")]
    assert list(open_library(tmp_path).motions["key"]) == [*keys, *map(str, range(7))]
    assert (tmp_path / "motions" / "part-000005.parquet").exists()


def test_there_is_one_writer_and_what_a_killed_one_left_is_removed(tmp_path):
    with writing(tmp_path), pytest.raises(RecordingError), writing(tmp_path):
        pass
    left = tmp_path / "motions" / ".part-000009.parquet.123.part"
    left.write_bytes(b"PAR1")
    with writing(tmp_path) as writer:
        assert not left.exists()
        writer.add([rows()])
    assert len(open_library(tmp_path).motions) == 1


def test_a_condition_takes_numbers_and_answers():
    row = {"frames": 30, "free": "inexact", "rmse": np.nan, "success": True}
    assert {*row} < {*CONDITION_NAMES}
    others = {"status": "ok", "feet": "false"}  # as an older version wrote it
    found = {name: condition_value(row | others, name) for name in ("ok", *row)}
    assert found == {"ok": 1.0, "frames": 30.0, "free": 0.5, "rmse": None, "success": 1.0}


def test_columns_have_units_and_types_for_every_reader(tmp_path):
    with writing(tmp_path) as writer:
        writer.add([rows()])
    (part,) = (tmp_path / "motions").glob("*.parquet")
    schema = parquet.read_schema(part)
    assert schema.names == list(MotionRow.model_fields)
    assert schema.field("max_tilt").metadata[b"unit"] == b"rad"
    types = [str(schema.field(name).type) for name in ("max_tilt", "success", "bolted")]
    assert types == ["double", "bool", "string"]
    assert str(pd.read_parquet(part)["frames"].dtype) in ("Int64", "float64", "object")


def test_what_need_not_be_computed(tmp_path):
    with writing(tmp_path) as writer:
        for status in ("ok", "broken", "slow", "error"):
            writer.add([rows(status, status, status=status, limits="1 s, 10 MB")])
    with writing(tmp_path) as writer:
        for limits, known in (("1 s, 10 MB", ["ok", "broken", "slow"]), ("5 s", ["ok", "broken"])):
            found = ("ok", "broken", "slow", "error", "unknown")
            assert [status for status in found if writer.has(status, limits)] == known


@pytest.mark.parametrize("name", ["motions", "joints"])
def test_no_library_and_a_damaged_one(tmp_path, name):
    with pytest.raises(RecordingError):
        open_library(tmp_path)
    with writing(tmp_path) as writer:
        writer.add([rows()])
    (part,) = (tmp_path / name).glob("*.parquet")
    part.write_bytes(part.read_bytes()[:100])
    with pytest.raises(RecordingError, match=part.name):
        open_library(tmp_path)
    with pytest.raises(RecordingError, match=part.name), writing(tmp_path) as writer:
        writer.add([rows(key="2")])


def test_a_setting_with_words_in_one_run_and_numbers_in_another_is_words(tmp_path):
    for number, value in enumerate((0.5, "bolted", 250.0)):
        with writing(tmp_path) as writer:
            writer.add([rows("wave", str(number), {"some": value}, variant=str(value))])
        found = list(open_library(tmp_path).motions["some"])
        assert found == ([0.5] if number == 0 else ["0.5", "bolted", "250"][: number + 1])
