"""What is found below paths."""

from __future__ import annotations

import os
from hashlib import sha256

import pytest

from g1stream.errors import ConfigError, MotionError
from g1stream.extras.library.files import content_hash, find_motions


def test_motions_below_a_directory(motions):
    found = find_motions([str(motions), str(motions / "first.npz"), str(motions / "notes.txt")])
    names = [path.removeprefix(f"{motions}/") for path in found]
    below = ["below/copy.npz", "below/third.npz"]
    assert names == ["broken.csv", "first.npz", "second.csv", *below, "notes.txt"]


def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "gone.csv").symlink_to(tmp_path / "nowhere")
    assert find_motions([str(tmp_path)]) == []
    for name in ("pipe.csv", "gone.csv"):
        with pytest.raises(MotionError):
            content_hash(tmp_path / name)


def test_a_recording_in_parts_is_one_motion(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    for name in ("metadata.yaml", "bag_0.mcap", "bag_1.mcap"):
        (bag / name).write_text(name)
    assert find_motions([str(tmp_path)]) == [str(bag)]
    assert content_hash(bag) == sha256(b"bag_0.mcapbag_1.mcapmetadata.yaml").hexdigest()


def test_a_library_is_no_motion_and_a_place_has_to_exist(checked):
    assert find_motions([str(checked[1])]) == []
    with pytest.raises(ConfigError):
        find_motions(["nowhere"])
