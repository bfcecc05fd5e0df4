import pickle
from dataclasses import replace

import numpy as np
import pytest

import g1stream
from g1stream.errors import MotionError
from g1stream.extras.formats.orders import names_in_order
from g1stream.robot.model import G1
from g1stream.robot.rotations import xyzw_from_wxyz
from known_arrays import WITHOUT_WRISTS, WRISTS, assert_motion, bodies, opened


def test_named_joints_behind_the_pelvis(npz, motion, isaac_angles):
    """As holosoma writes them; the names may be objects."""
    pose = np.hstack([motion.root_pos, motion.root_quat_wxyz, isaac_angles])
    names = np.array(names_in_order("isaaclab"), dtype=object)
    file = opened(npz(joint_pos=pose, joint_names=names, **bodies(motion)))
    assert file.evidence.used["joint order"] == "named by the file"
    assert_motion(file.motion(), motion)


def with_root(pos, quat):
    return {"dof": np.zeros((9, 29)), "root_pos": pos, "root_rot": quat}


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({"poses": np.zeros((9, 72)), "trans": np.zeros((9, 3))}, "human"),
        ({"dof": np.zeros((9, 12))}, "12 columns"),
        ({"dof": np.zeros(9)}, "dof"),
        ({"dof": ["a", "b"]}, "dof"),
        ({"dof": np.zeros((9, 29)), "fps": "fast"}, "fps"),
        (with_root(np.zeros((8, 3)), np.ones((9, 4))), "8"),
        (with_root(np.zeros((9, 3)), np.ones((9, 3))), "3"),
        ({"dof": np.zeros((9, 2)), "dof_names": ["left_knee", "right_knee"]}, "lacks"),
        ({"a": {}, "b": {}}, "2 motions.*: a, b"),
        ([1, 2, 3], "no named arrays"),
        ({"dof": {1, 2}}, "set"),
        ({"dof": np.zeros((9, 71))}, "71 columns"),
        ({"dof": np.full((9, 36), 1e308)}, "finite"),
        (with_root(np.zeros((9, 3)), np.full((9, 4), np.nan)), "root_rot .* finite"),
        ({"dof": np.zeros((9, 2)), "dof_names": ["left_knee", "left_knee_joint"]}, "twice"),
        (
            {
                "dof": np.zeros((9, 29)),
                "body_pos": np.zeros((8, 1, 3)),
                "body_quat": np.ones((9, 1, 4)),
            },
            "8, 1, 3",
        ),
    ],
)
def test_what_is_no_motion(pkl, arrays, reason):
    with pytest.raises(MotionError, match=reason):
        g1stream.load_motion(pkl(pickle.dumps(arrays)), joint_order="motor")


def test_bodies_under_other_names(npz, motion):
    pos, quat = bodies(motion).values()
    arrays = {"dof_positions": motion.joint_pos, "dof_names": motion.joint_names}
    path = npz(body_positions=pos, body_rotations=quat, **arrays)
    assert_motion(g1stream.load_motion(path), motion, tolerance=1e-6)


@pytest.mark.parametrize("layout", ["names", "no names", "table", "CSV"])
def test_wrists_that_a_file_leaves_out_stay_at_zero(npz, tmp_path, motion, layout):
    angles, quat = motion.joint_pos[:, WITHOUT_WRISTS], motion.root_quat_wxyz
    if layout == "CSV":
        table = np.hstack([motion.root_pos, xyzw_from_wxyz(quat), angles])
        path = tmp_path / "motion.csv"
        np.savetxt(path, table, "%.17g", delimiter=",")
    elif layout == "table":
        path = npz(qpos=np.hstack([motion.root_pos, quat, angles]))
    else:
        names = [g1stream.JOINT_NAMES[i] for i in WITHOUT_WRISTS]
        named = {"joint_names": names} if layout == "names" else {}
        path = npz(dof=angles, root_pos=motion.root_pos, root_quat=quat, **named)
    found = g1stream.load_motion(path, fps=50)
    expected = motion.joint_pos.copy()
    expected[:, WRISTS] = 0.0
    assert_motion(found, replace(motion, joint_pos=expected))
    (warning,) = (text for text in found.warnings if "assumed" not in text)
    assert all(g1stream.JOINT_NAMES[i] in warning for i in WRISTS)
    assert opened(path).evidence.missing == tuple(g1stream.JOINT_NAMES[i] for i in WRISTS)
    smaller = G1.load("g1_23dof")
    on_smaller = g1stream.load_motion(path, fps=50, robot=smaller)
    assert len(on_smaller.warnings) == len(found.warnings) - 1


def test_the_joints_of_a_g1_with_23_are_read(npz, motion):
    present = G1.load("g1_23dof").present
    names = np.array(g1stream.JOINT_NAMES)[present]
    path = npz(joint_pos=motion.joint_pos[:, present], joint_names=names)
    expected = replace(motion, joint_pos=motion.joint_pos * present)
    assert_motion(g1stream.load_motion(path), expected, root=False)


def test_a_quaternion_before_the_position_is_told_by_its_norm(npz, motion):
    path = npz(qpos=np.hstack([motion.root_quat_wxyz, motion.root_pos, motion.joint_pos]))
    found = g1stream.load_motion(path)
    assert_motion(found, motion)
    assert found.warnings == ()
    assert "norm" in opened(path).evidence.used["pelvis"]


def test_the_pose_of_an_object_behind_the_joints_is_left_out(npz, motion):
    box = np.tile([0.5, 0.1, 0.4, 1, 0, 0, 0], (motion.n_frames, 1))
    qpos = np.hstack([motion.root_pos, motion.root_quat_wxyz, motion.joint_pos, box])
    found = g1stream.load_motion(npz(qpos=qpos, cost=1.0, boxes=box, notes="none"))
    assert_motion(found, motion)
    (warning,) = found.warnings
    assert all(word in warning for word in ("7 columns of qpos", "cost", "boxes"))
    assert "notes" not in warning  # neither a number nor a row a frame


@pytest.mark.parametrize("rate", [{"sample_rate": 50}, {"frequency": 50.0}, {"dt": 0.02}])
def test_root_and_rate_under_other_names(tmp_path, motion, rate):
    path = tmp_path / "motion.npz"
    pose = {"base_pos_w": motion.root_pos, "base_quat_w": motion.root_quat_wxyz}
    names = np.array(motion.joint_names, dtype="S")
    np.savez(path, joint_names=names, Joint_Pos=motion.joint_pos, **pose, **rate)
    assert_motion(g1stream.load_motion(path), motion)
    assert g1stream.load_motion(path, fps=25).fps == 25.0
    np.savez(path, joint_names=names, joint_pos=motion.joint_pos, pelvis=motion.root_pos, speed=50)
    found = g1stream.load_motion(path)
    assert all(name in found.warnings[0] for name in ("pelvis", "speed"))
    assert opened(path).evidence.assumed.keys() == {"pelvis", "frame rate"}


@pytest.mark.parametrize(
    ("name", "hinted"), [("take_120hz", True), ("run 60 FPS", True), ("walk_30fps", False)]
)
def test_a_rate_in_the_name_is_a_hint_alone(tmp_path, motion, name, hinted):
    path = motion.save(tmp_path / f"{name}.csv")
    found = g1stream.load_motion(path)
    assert found.fps == 30.0
    assert ["--fps" in text for text in found.warnings] == [True] * hinted
    assert g1stream.load_motion(path, fps=60).warnings == ()


def test_a_pelvis_that_lies_on_the_floor_is_no_evidence(npz, motion):
    """On its side, it would stand in the other order of the quaternion."""
    side = np.tile([0.5**0.5, 0.5**0.5, 0, 0], (motion.n_frames, 1))
    pose = {"root_pos": motion.root_pos - [0, 0, 0.65], "root_quat": side}
    path = npz(q=motion.joint_pos, joint_names=motion.joint_names, **pose)
    np.testing.assert_allclose(g1stream.load_motion(path).root_quat_wxyz, side, rtol=0, atol=1e-15)
