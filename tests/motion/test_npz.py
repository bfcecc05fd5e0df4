import io

import numpy as np
import pytest

from g1stream.errors import MotionError
from g1stream.motion.npz import read_npy
from g1stream.motion.readers import find_motion, load_motion
from g1stream.robot.joints import JOINT_NAMES


@pytest.fixture
def write(tmp_path, wild_motion):
    """Write the arrays of a motion, some of them changed; gives the path."""

    def write_arrays(name="motion.npz", **changes):
        arrays = {name: getattr(wild_motion, name) for name in ("joint_pos", "root_pos")}
        arrays |= {"fps": 50.0, "joint_names": np.array(JOINT_NAMES)}
        arrays["root_quat_wxyz"] = wild_motion.root_quat_wxyz
        np.savez(tmp_path / name, **(arrays | changes))
        return tmp_path / name

    return write_arrays


def test_what_is_in_the_file_is_told(write, wild_motion):
    path = write("take_120hz.npz")
    found, evidence = load_motion(path), find_motion(path).open().evidence
    for name in ("joint_pos", "root_pos", "root_quat_wxyz"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wild_motion, name))
    assert (found.fps, found.name, found.warnings) == (50.0, "take_120hz", ())
    assert load_motion(path, fps=25).fps == 25.0
    assert evidence.used.keys() == {"file", "joint order", "pelvis", "frame rate"}
    assert (evidence.assumed, evidence.not_used, evidence.missing) == ({}, (), ())


def test_joints_are_found_by_name(write, wild_motion):
    path = write(joint_names=np.array(JOINT_NAMES[::-1]), joint_pos=wild_motion.joint_pos[:, ::-1])
    np.testing.assert_array_equal(load_motion(path).joint_pos, wild_motion.joint_pos)


def test_a_quaternion_far_off_is_made_unit_with_a_warning(write, wild_motion):
    quat = wild_motion.root_quat_wxyz.copy()
    quat[7] *= 1.3
    (warning,) = load_motion(write(root_quat_wxyz=quat)).warnings
    assert all(words in warning for words in ("1 of 40", "frame 7", "1.3", "rounding error"))
    quat[9] = 0.0
    with pytest.raises(MotionError, match="frame 9"):
        load_motion(write(root_quat_wxyz=quat))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e10])
def test_numbers_that_are_not_finite_or_too_large_are_refused(write, wild_motion, value):
    root_pos = wild_motion.root_pos.copy()
    root_pos[3, 1] = value
    with pytest.raises(MotionError, match=r"root_pos .* finite"):
        load_motion(write(root_pos=root_pos))


@pytest.mark.parametrize("place", [0.2, 0.5, 0.999])
def test_a_file_that_is_cut_off_is_said_to_be(write, place):
    path = write()
    content = path.read_bytes()
    path.write_bytes(content[: int(place * len(content))])
    with pytest.raises(MotionError, match="damaged or incomplete"):
        load_motion(path)


def test_objects_in_an_array_stay_pickled():
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], dtype=object))
    found = read_npy(file.getvalue())
    assert isinstance(found, bytes)
    assert found.startswith(b"\x80")
