import pickle

import numpy as np
import pytest

import g1stream
from g1stream.errors import MotionError
from g1stream.robot.rotations import xyzw_from_wxyz
from known_arrays import assert_motion, opened


def test_one_of_several_motions_is_taken_by_its_name(pkl, motion):
    arrays = {"dof": motion.joint_pos, "fps": motion.fps, "root_trans_offset": motion.root_pos}
    arrays["root_rot"] = xyzw_from_wxyz(motion.root_quat_wxyz)
    other = {**arrays, "dof": np.zeros_like(motion.joint_pos)}
    path = pkl(pickle.dumps({"walk/0:1": arrays, "stand": other}))
    found = g1stream.load_motion(f"{path}:stand", joint_order="motor")
    assert found.name == "stand"
    assert found.source == path
    assert not found.joint_pos.any()
    for wrong in ("run", "", "dof"):
        with pytest.raises(MotionError):
            g1stream.load_motion(f"{path}:{wrong}")
    with pytest.raises(MotionError) as refused:
        g1stream.load_motion(path)
    assert refused.value.remedy.endswith(f"{path}:walk/0:1")
    assert_motion(g1stream.load_motion(f"{path}:walk/0:1", joint_order="motor"), motion)


def test_a_file_of_one_motion_has_no_other(tmp_path, motion):
    for path in (motion.save(tmp_path / "m.npz"), motion.save(tmp_path / "m.csv")):
        with pytest.raises(MotionError):
            g1stream.load_motion(f"{path}:m")


@pytest.mark.parametrize("suffix", ["npz", "npy"])
def test_a_file_that_is_cut_off_is_said_to_be(tmp_path, motion, suffix):
    path = tmp_path / f"motion.{suffix}"
    if suffix == "npy":
        np.save(path, np.zeros((30, 36)))
    else:
        motion.save(path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(MotionError, match=rf"^motion.{suffix}: .*damaged or incomplete"):
        opened(path)


def test_one_array(tmp_path, motion):
    path = tmp_path / "motion.npy"
    np.save(path, np.hstack([motion.root_pos, motion.root_quat_wxyz, motion.joint_pos]))
    assert_motion(g1stream.load_motion(path, fps=50, joint_order="motor"), motion)
