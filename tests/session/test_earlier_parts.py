"""What a session in parts replaces, and what it leaves alone."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from g1stream.errors import RecordingError
from g1stream.session.file_names import parts_of
from g1stream.session.rotation import Limits, PartedWriter
from g1stream.session.session import open_session
from g1stream.session.writer import SessionWriter

T0 = 1_700_000_000_000_000_000
SECOND = 10**9
EACH_SECOND = Limits(duration=SECOND)


def record(path, seconds, *, force=False, limits=EACH_SECOND):
    """A part for each second, and one for what is left; returns the parts."""
    with PartedWriter(path, lambda _: None, limits, force=force) as writer:
        for i in range(round(seconds * 10)):
            now = T0 + i * SECOND // 10
            writer.write("/lowcmd", bytes(8), now, now)
            writer.flush_if_due(now)
    return writer.paths


def content(directory):
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_old_parts_are_refused_or_all_replaced(tmp_path):
    path = tmp_path / "s.mcap"
    assert len(record(path, 3.5)) == 4
    before = content(tmp_path)
    with pytest.raises(RecordingError, match=r"s_001\.mcap exists already\. .*--force"):
        record(path, 1)
    assert content(tmp_path) == before
    assert record(path, 1, force=True) == parts_of(path) == [tmp_path / "s_001.mcap"]


def test_parts_whose_first_are_gone_are_still_one_session(tmp_path):
    path = tmp_path / "s.mcap"
    for part in record(path, 3.5)[:2]:
        part.unlink()
    assert parts_of(path) == [tmp_path / "s_003.mcap", tmp_path / "s_004.mcap"]
    assert record(path, 1, force=True) == parts_of(path) == [tmp_path / "s_001.mcap"]


def nothing_of_ours(path):
    path.write_bytes(b"precious")


def empty(path):
    path.touch()


def part_of_another_session(path):
    elsewhere = path.parent / "elsewhere"
    elsewhere.mkdir()
    record(elsewhere / "x.mcap", 2.5)[2].rename(path)
    for rest in elsewhere.iterdir():
        rest.unlink()
    elsewhere.rmdir()


def session_in_one_file(path):
    record(path, 1, limits=None)


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize(
    ("stranger", "old_parts"),
    [
        (nothing_of_ours, 0),
        (empty, 0),
        (session_in_one_file, 0),
        (nothing_of_ours, 2),
        (part_of_another_session, 2),
    ],
)
def test_a_stranger_with_the_name_of_a_part_is_refused_first(tmp_path, stranger, old_parts, force):
    path = tmp_path / "s.mcap"
    if old_parts:
        record(path, old_parts)
    stranger(tmp_path / "s_003.mcap")
    before = content(tmp_path)
    with pytest.raises(
        RecordingError, match=r"s_003\.mcap has the name of part 3 .* Move it away"
    ) as caught:
        # Fewer parts than three: it is refused before anybody knows how many there will be.
        record(path, 1, force=force)
    assert "--force" not in caught.value.remedy
    assert content(tmp_path) == before


def test_a_directory_with_the_name_of_a_part_is_refused(tmp_path):
    (tmp_path / "s_001.mcap").mkdir()
    with pytest.raises(RecordingError, match=r"s_001\.mcap has the name of part 1"):
        record(tmp_path / "s.mcap", 1, force=True)


def test_what_comes_into_the_way_later_is_not_replaced_either(tmp_path):
    with PartedWriter(tmp_path / "s.mcap", lambda _: None, EACH_SECOND, force=True) as writer:
        (tmp_path / "s_002.mcap").write_bytes(b"precious")
        writer.flush_if_due(T0)
        with pytest.raises(RecordingError, match=r"s_002\.mcap exists already"):
            writer.flush_if_due(T0 + SECOND)
    assert (tmp_path / "s_002.mcap").read_bytes() == b"precious"
    assert writer.paths == [tmp_path / "s_001.mcap"]


def test_numbers_that_no_recording_gets_to_are_left_alone(tmp_path):
    strangers = [tmp_path / "walk_20240301.mcap", tmp_path / "walk_0002.mcap"]
    record(strangers[0], 1, limits=None)
    strangers[1].write_bytes(b"not an MCAP")
    before = content(tmp_path)
    for force in (False, True):
        assert len(record(tmp_path / "walk.mcap", 2.5, force=force)) == 3
        assert before.items() <= content(tmp_path).items()


def test_a_part_that_cannot_be_removed_is_said(tmp_path, monkeypatch):
    record(tmp_path / "s.mcap", 1)
    before = content(tmp_path)
    unlink = Path.unlink

    def denied(path, **how):
        if path.name not in before:
            return unlink(path, **how)
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("pathlib.Path.unlink", denied)
    with pytest.raises(RecordingError, match=r"s_001\.mcap cannot be removed: Permission denied"):
        record(tmp_path / "s.mcap", 1, force=True)
    assert content(tmp_path) == before


def test_a_session_in_one_file_would_be_opened_instead_and_is_refused_or_replaced(tmp_path):
    path = tmp_path / "s.mcap"
    record(path, 1, limits=None)
    before = content(tmp_path)
    with pytest.raises(RecordingError, match=r"s\.mcap exists already\. .*--force"):
        record(path, 2.5)
    assert content(tmp_path) == before
    parts = record(path, 2.5, force=True)
    assert len(parts) == 3
    assert open_session(path).paths == parts == sorted(tmp_path.iterdir())


@pytest.mark.parametrize("stranger", [nothing_of_ours, empty, Path.mkdir, os.mkfifo])
@pytest.mark.parametrize("force", [False, True])
def test_anything_else_that_would_be_opened_instead_is_refused(tmp_path, stranger, force):
    path = tmp_path / "s.mcap"
    record(path, 1)
    stranger(path)
    there = sorted(tmp_path.iterdir())
    with pytest.raises(RecordingError, match=r"s\.mcap would be opened .* Move it") as caught:
        record(path, 1, force=force)
    assert "--force" not in caught.value.remedy
    assert sorted(tmp_path.iterdir()) == there


def cut(path):
    """An MCAP that ends before anything was noted in it."""
    with SessionWriter(path) as writer:
        size = writer.size
    os.truncate(path, size)


def damaged(path):
    cut(path)
    # Metadata of three bytes, too few to be any.
    path.write_bytes(path.read_bytes() + b"\x0c" + (3).to_bytes(8, "little") + b"\xff\xff\xff")


def zeros(path):
    path.write_bytes(bytes(4096))


@pytest.mark.parametrize("remains", [empty, zeros, cut, damaged])
def test_what_a_power_cut_left_of_a_part_is_missed_and_replaced(tmp_path, remains):
    path = tmp_path / "s.mcap"
    assert len(record(path, 3)) == 3
    for number in ("002", "004", "005"):
        (tmp_path / f"s_{number}.mcap").unlink(missing_ok=True)
        remains(tmp_path / f"s_{number}.mcap")
    session = open_session(path)
    assert session.absent_parts == list(session.unreadable_parts) == [2, 4, 5]
    assert record(path, 1, force=True) == sorted(tmp_path.iterdir()) == [tmp_path / "s_001.mcap"]


@pytest.mark.parametrize("stranger", [nothing_of_ours, part_of_another_session])
def test_what_says_that_it_is_no_part_is_neither_missed_nor_replaced(tmp_path, stranger):
    path = tmp_path / "s.mcap"
    parts = record(path, 2)
    stranger(tmp_path / "s_003.mcap")
    session = open_session(path)
    assert session.paths == parts
    assert session.absent_parts == []
    with pytest.raises(RecordingError, match="Move it away"):
        record(path, 1, force=True)


def test_remains_with_a_gap_before_them_belong_to_nobody(tmp_path):
    path = tmp_path / "s.mcap"
    record(path, 2)
    empty(tmp_path / "s_004.mcap")
    assert open_session(path).absent_parts == []
    with pytest.raises(RecordingError, match=r"s_004\.mcap has the name of part 4"):
        record(path, 1, force=True)


def test_what_may_not_be_read_is_missed_and_not_replaced(tmp_path, monkeypatch):
    path = tmp_path / "s.mcap"
    record(path, 2)
    locked = tmp_path / "s_003.mcap"
    locked.touch()
    opened = Path.open

    def denied(path, *how, **more):
        if path == locked:
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path, *how, **more)

    monkeypatch.setattr("pathlib.Path.open", denied)
    assert "Permission denied" in open_session(path).unreadable_parts[3]
    with pytest.raises(RecordingError, match=r"s_003\.mcap has the name of part 3"):
        record(path, 1, force=True)


@pytest.mark.parametrize("earlier", ["parts", "whole"])
def test_without_a_new_part_the_earlier_session_stays(tmp_path, earlier):
    path = tmp_path / "s.mcap"
    record(path, 2.5, limits=EACH_SECOND if earlier == "parts" else None)
    before = content(tmp_path)

    def broken(_):
        raise RecordingError("No room.", "Make some.")

    with pytest.raises(RecordingError, match="No room"):
        PartedWriter(path, broken, EACH_SECOND, force=True)
    assert content(tmp_path) == before
