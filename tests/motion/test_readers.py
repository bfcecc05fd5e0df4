"""Motion files are found by path or by the name of a bundled motion, and read by their format."""

from __future__ import annotations

import os

import pytest

from g1stream.errors import MotionError
from g1stream.motion.readers import BUNDLED_MOTIONS, FORMATS, load_motion


@pytest.mark.parametrize("name", BUNDLED_MOTIONS)
def test_bundled_motions_by_name(name):
    motion = load_motion(name)
    assert motion.name == name
    assert motion.source.name == f"{name}.csv"
    assert motion.warnings == ()


def test_a_missing_file_is_named_with_the_choices(tmp_path):
    with pytest.raises(MotionError) as caught:
        load_motion(tmp_path / "walk.csv")
    assert str(tmp_path / "walk.csv") in caught.value.cause
    assert all(choice in caught.value.remedy for choice in ("motion file", "session file", "demo"))


@pytest.mark.parametrize("kind", ["directory", "link loop", "pipe"])
def test_paths_that_are_not_readable_files(tmp_path, kind):
    path = tmp_path / "odd.csv"
    if kind == "directory":
        path.mkdir()
    elif kind == "link loop":
        path.symlink_to(path)
    else:
        os.mkfifo(path)
    with pytest.raises(MotionError, match=r"odd\.csv"):
        load_motion(path)


@pytest.mark.parametrize("name", [f"{'a' * 300}:b", "a\0:b", ":", "a:"])
def test_names_that_no_file_can_have(name):
    with pytest.raises(MotionError):
        load_motion(name)


def test_a_directory_is_told_from_a_bag(tmp_path):
    with pytest.raises(MotionError, match=r"metadata\.yaml"):
        load_motion(tmp_path)


@pytest.mark.parametrize(
    "content",
    [b"HIERARCHY\nROOT Hips\n", b"\x89HDF\r\n\x1a\n", b'{"fps": 30}', b"<?xml?>", b"\xff\xfe"],
)
def test_what_is_in_no_format_is_told_the_formats(tmp_path, content):
    path = tmp_path / "motion"
    path.write_bytes(content)
    with pytest.raises(MotionError, match="no supported format") as caught:
        load_motion(path)
    assert all(one.name in caught.value.remedy for one in FORMATS)


@pytest.mark.parametrize("name", ["motion.csv", "motion.npz"])
def test_a_pointer_of_git_lfs_is_not_the_file(tmp_path, name):
    path = tmp_path / name
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(MotionError, match="Git LFS"):
        load_motion(path)
