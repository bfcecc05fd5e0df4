"""Motion files are found by path or by the name of a bundled motion."""

from __future__ import annotations

import os

import pytest

from g1stream.errors import MotionError
from g1stream.motion.files import BUNDLED_MOTIONS, open_motion_file


@pytest.mark.parametrize("name", BUNDLED_MOTIONS)
def test_bundled_motions_by_name(name):
    motion = open_motion_file(name).motion()
    assert motion.name == name
    assert motion.source.name == f"{name}.csv"
    assert motion.warnings == ()


def test_a_missing_file_is_named_with_the_choices(tmp_path):
    with pytest.raises(MotionError) as caught:
        open_motion_file(tmp_path / "walk.csv")
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
        open_motion_file(path)


@pytest.mark.parametrize("name", [f"{'a' * 300}:b", "a\0:b", ":", "a:"])
def test_names_that_no_file_can_have(name):
    with pytest.raises(MotionError):
        open_motion_file(name)


def test_a_directory_is_told_from_a_bag(tmp_path):
    with pytest.raises(MotionError, match=r"metadata\.yaml"):
        open_motion_file(tmp_path)
