"""Columns without names whose number has several readings."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import g1stream
from g1stream.errors import MotionError
from known_arrays import assert_motion, bodies, opened


def csv(path, *columns, separator=","):
    np.savetxt(path, np.column_stack(columns), "%.17g", delimiter=separator)
    return path


@pytest.mark.parametrize("pelvis", [False, True])
@pytest.mark.parametrize(
    ("step", "fps", "unused"), [(0.02, 50.0, ()), (1.0, 30.0, ("the first column of table",))]
)
def test_a_time_or_a_number_of_a_frame_before_29_joints(
    tmp_path, motion, step, fps, unused, pelvis
):
    """30 columns, of which 7 could be a pelvis, and 37."""
    quat = motion.root_quat_wxyz[:, [1, 2, 3, 0]]
    pose = [motion.root_pos, quat] * pelvis
    times = step * np.arange(motion.n_frames)
    path = csv(tmp_path / "motion.csv", times, *pose, motion.joint_pos)
    found = g1stream.load_motion(path)
    assert found.fps == fps
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos)
    if pelvis:
        np.testing.assert_array_equal(found.root_pos, motion.root_pos)
    assert opened(path).evidence.not_used == unused
    assert sum("not used" in text for text in found.warnings) == len(unused)


def test_a_pelvis_that_moves_evenly_is_no_time(tmp_path, motion):
    """On a treadmill: 7 columns and 23 joints."""
    joints = motion.joint_pos[:, [i for i in range(29) if "wrist" not in g1stream.JOINT_NAMES[i]]]
    pos = motion.root_pos.copy()
    pos[:, 0] = 0.01 * np.arange(len(pos))
    path = csv(tmp_path / "motion.csv", pos, motion.root_quat_wxyz[:, [1, 2, 3, 0]], joints)
    np.testing.assert_array_equal(g1stream.load_motion(path).root_pos, pos)


@pytest.mark.parametrize("told", ["bodies", "limits", "names"])
@pytest.mark.parametrize("first", [False, True])
def test_a_door_beside_29_joints(npz, motion, told, first):
    """As in the files of HDMI. A column before the joints would move all of them by one."""
    door = -1.5 * np.sin(np.arange(motion.n_frames) / 50)[:, np.newaxis] ** 2
    columns = [door, motion.joint_pos] if first else [motion.joint_pos, door]
    more = bodies(motion) if told == "bodies" else {}
    if told == "names":
        names = [*motion.joint_names]
        more = {"joint_names": ["door", *names] if first else [*names, "door"]}
    scale = 0.3 if told == "bodies" else 1.0  # limits say nothing
    if scale < 1.0:
        calm = g1stream.Motion.from_arrays(
            scale * motion.joint_pos, motion.root_pos, motion.root_quat_wxyz, fps=50
        )
        columns, more = [scale * one for one in columns], bodies(calm)
    path = npz(joint_pos=np.hstack(columns), **more)
    found = g1stream.load_motion(path)
    np.testing.assert_array_equal(found.joint_pos, scale * motion.joint_pos)
    if told == "bodies":
        assert_motion(found, calm, tolerance=1e-6)
    (unused,) = opened(path).evidence.not_used
    assert unused == (
        "door_joint"
        if told == "names"
        else f"the {'first' if first else 'last'} column of joint_pos"
    )
    assert unused in found.warnings[0]


def test_a_column_too_many_is_refused_if_nothing_tells_which(npz, motion):
    calm = 0.1 * motion.joint_pos
    squat = calm.copy()
    squat[:, [3, 4, 5, 6]] = [0.9, -0.4, 0.0, -0.4]  # a norm of 1.06, as of a bad quaternion
    for joints in (calm, squat):
        path = npz(joint_pos=np.hstack([joints, 0.1 * np.sin(joints[:, :1])]))
        with pytest.raises(MotionError) as refused:
            g1stream.load_motion(path, joint_order="motor")
        cause = refused.value.cause
        assert all(one in cause for one in ("30 columns", "29 joints", "23 joints"))


def test_columns_are_no_quaternion_if_most_norms_are_not_1(tmp_path, motion):
    """A few rows with another norm are faults of a quaternion."""
    quat = motion.root_quat_wxyz[:, [1, 2, 3, 0]].copy()
    quat[:5] *= 0.3
    path = csv(tmp_path / "motion.csv", motion.root_pos, quat, motion.joint_pos)
    assert any("norm" in text for text in g1stream.load_motion(path).warnings)
    csv(path, motion.root_pos, 0.3 * motion.root_quat_wxyz[:, [1, 2, 3, 0]], motion.joint_pos)
    with pytest.raises(MotionError, match="36 columns"):
        g1stream.load_motion(path)


@pytest.mark.parametrize("heading", [0.0, np.pi / 2])
def test_frames_of_mimickit(pkl, heading):
    """Position, exponential map and joints in one list; its tool takes the joints from GMR."""
    t = np.arange(60) / 30
    joints = np.zeros((60, 29))
    joints[:, 22] = 0.3 * np.sin(t)
    turn = Rotation.from_euler("zyx", [heading, 0.1, 0.2])
    pose = np.tile([1.0, 2.0, 0.79, *turn.as_rotvec()], (60, 1))
    frames = np.hstack([pose, joints]).tolist()
    path = pkl(pickle.dumps({"loop_mode": 0, "fps": 30, "frames": frames}))
    found = g1stream.load_motion(path)
    np.testing.assert_array_equal(found.joint_pos, joints)
    np.testing.assert_allclose(found.root_pos, pose[:, :3], rtol=0, atol=1e-15)
    there = Rotation.from_quat(found.root_quat_wxyz[:, [1, 2, 3, 0]])
    np.testing.assert_allclose((there * turn.inv()).magnitude(), 0.0, atol=1e-7)
    assert opened(path).evidence.assumed.keys() == {"joint order"}
    some = [i for i, one in enumerate(g1stream.JOINT_NAMES) if "wrist" not in one]
    frames = np.hstack([pose, joints[:, some]])  # 29 columns, which are no 29 joints
    found = g1stream.load_motion(pkl(pickle.dumps({"fps": 30, "frames": frames})))
    np.testing.assert_array_equal(found.joint_pos[:, some], joints[:, some])
    np.testing.assert_array_equal(found.root_pos, pose[:, :3])
    with pytest.raises(MotionError, match="36 columns"):
        g1stream.load_motion(pkl(pickle.dumps({"frames": np.zeros((9, 36))})))
