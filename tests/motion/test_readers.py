import os
from pathlib import Path

import pytest

from g1stream.errors import MotionError
from g1stream.motion.readers import BUNDLED_MOTIONS, FORMATS, load_motion


@pytest.mark.parametrize("name", BUNDLED_MOTIONS)
def test_bundled_motions_by_name(name):
    motion = load_motion(name)
    assert motion.source.name == f"{motion.name}.csv" == f"{name}.csv"
    assert motion.warnings == ()


@pytest.mark.parametrize(
    "make",
    [lambda path: path.exists(), Path.mkdir, lambda path: path.symlink_to(path), os.mkfifo],
    ids=["missing", "directory", "link loop", "pipe"],
)
def test_paths_that_are_not_readable_files(tmp_path, make):
    path = tmp_path / "odd.csv"
    make(path)
    with pytest.raises(MotionError, match=r"odd\.csv"):
        load_motion(path)


def test_a_directory_is_told_from_a_bag(tmp_path):
    with pytest.raises(MotionError, match=r"metadata\.yaml"):
        load_motion(tmp_path)


@pytest.mark.parametrize("name", [f"{'a' * 300}:b", "a\0:b", ":", "a:"])
def test_names_that_no_file_can_have(name):
    with pytest.raises(MotionError):
        load_motion(name)


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
