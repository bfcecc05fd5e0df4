"""What is found below paths and URLs."""

from __future__ import annotations

import os
from hashlib import sha256

import pytest

from g1stream.errors import ConfigError, MotionError
from g1stream.library.files import content_hash, find_motions, local_copy


def test_motions_below_a_directory(motions):
    found = find_motions([str(motions), str(motions / "first.npz")])
    names = [path.removeprefix(f"{motions}/") for path in found]
    assert names == ["broken.csv", "first.npz", "second.csv", "below/copy.npz", "below/third.npz"]


def test_a_named_file_is_taken_whatever_its_name(motions):
    assert find_motions([str(motions / "notes.txt")]) == [str(motions / "notes.txt")]


def test_urls_are_those_of_fsspec(motions):
    pytest.importorskip("fsspec")
    found = find_motions([f"file://{motions}"])
    assert {url.rpartition("/")[2] for url in found} == {
        "broken.csv",
        "first.npz",
        "second.csv",
        "copy.npz",
        "third.npz",
    }
    (url,) = find_motions([f"file://{motions}/first.npz"])
    with local_copy(url) as path:
        assert path.name == "first.npz"
        assert path.read_bytes() == (motions / "first.npz").read_bytes()
        assert path.parent != motions
    assert not path.exists()
    assert content_hash(url) == sha256((motions / "first.npz").read_bytes()).hexdigest()


def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "gone.csv").symlink_to(tmp_path / "nowhere")
    assert find_motions([str(tmp_path)]) == []
    for name in ("pipe.csv", "gone.csv"):
        with pytest.raises(MotionError):
            content_hash(str(tmp_path / name))


def test_a_recording_in_parts_is_one_motion(tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    for name in ("metadata.yaml", "bag_0.mcap", "bag_1.mcap"):
        (bag / name).write_text(name)
    assert find_motions([str(tmp_path)]) == [str(bag)]
    assert content_hash(str(bag)) == sha256(b"bag_0.mcapbag_1.mcapmetadata.yaml").hexdigest()


@pytest.mark.parametrize("place", ["nowhere", "file:///nowhere/at/all.csv", "nosuch://x"])
def test_places_that_do_not_exist(place):
    with pytest.raises(ConfigError):
        find_motions([place])


def test_a_library_is_no_motion(checked):
    assert find_motions([str(checked[1])]) == []
