from dataclasses import replace

import numpy as np
import pytest

import g1stream
from known_arrays import close, opened, written


def test_lafan1_has_36_columns_at_30_fps_and_no_header(wild_motion, tmp_path):
    motion = replace(wild_motion, fps=30.0)
    found = np.loadtxt(written(motion, "lafan1", tmp_path), delimiter=",")
    assert found.shape == (40, 36)
    close(found[:, :3], motion.root_pos, 1e-6)
    close(found[:, 3:7], motion.root_quat_wxyz[:, [1, 2, 3, 0]], 1e-6)
    close(found[:, 7:], motion.joint_pos, 1e-6)


@pytest.mark.parametrize("header", [False, True])
def test_nothing_of_its_layout_is_warned_of(tmp_path, motion, header):
    """It is the most common one. `g1stream motion` shows what is assumed."""
    quat = motion.root_quat_wxyz[:, [1, 2, 3, 0]]
    table = np.column_stack([np.arange(len(quat)), motion.root_pos, quat, motion.joint_pos])
    names = ["Frame", "X", "Y", "Z", "QX", "QY", "QZ", "QW", *motion.joint_names]
    path = tmp_path / "walk.csv"
    if header:
        np.savetxt(path, table, delimiter=",", header=",".join(names), comments="")
    else:
        np.savetxt(path, table[:, 1:], delimiter=",")
    assert g1stream.load_motion(path).warnings == ()
    assert opened(path).evidence.assumptions["frame rate"] == "30 fps, assumed"
    # Other columns, another order or another rate in the name are not usual.
    np.savetxt(path, table[:, 8:], delimiter=",")
    assert any("30 fps" in text for text in g1stream.load_motion(path).warnings)
    np.savetxt(tmp_path / "walk_50hz.csv", table[:, 1:], delimiter=",")
    (hint,) = g1stream.load_motion(tmp_path / "walk_50hz.csv").warnings
    assert "--fps 50" in hint


def test_the_published_dances_give_no_warning(real_clip):
    for path in real_clip.parent.glob("*.csv"):
        assert g1stream.load_motion(path).warnings == ()
