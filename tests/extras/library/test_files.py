import os
from hashlib import sha256

import pytest

from g1stream.errors import ConfigError, MotionError
from g1stream.extras.library.files import content_hash, find_motions

NAMES = ["broken.csv", "first.npz", "second.csv", "below/copy.npz", "below/third.npz"]


def test_motions_below_a_directory_and_a_named_file_whatever_its_name(motions, checked):
    found = find_motions([str(motions), str(motions / "first.npz")])
    assert [path.removeprefix(f"{motions}/") for path in found] == NAMES
    assert find_motions([str(motions / "notes.txt")]) == [str(motions / "notes.txt")]
    assert find_motions([str(checked[1])]) == []  # a library


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


@pytest.mark.parametrize("place", ["nowhere", "nowhere.pkl:walk", "file:///motions"])
def test_places_that_do_not_exist(place):
    with pytest.raises(ConfigError):
        find_motions([place])
