from dataclasses import replace

import numpy as np
import pytest

import g1stream
from g1stream.errors import MotionError
from g1stream.motion.readers import find_motion
from g1stream.robot.model import G1
from g1stream.robot.rotations import xyzw_from_wxyz
from known_arrays import ISAACLAB, WRISTS, assert_motion, bodies, opened


@pytest.mark.parametrize(
    ("order", "robot"), [("motor", "g1_29dof_rev_1_0"), ("isaaclab", "g1_29dof")]
)
def test_order_told_by_bodies(npz, motion, isaac_angles, order, robot):
    """BeyondMimic and mjlab write the same arrays, in different orders."""
    angles = motion.joint_pos if order == "motor" else isaac_angles
    file = opened(npz(fps=[50], joint_pos=angles, joint_vel=0 * angles, **bodies(motion, robot)))
    assert file.evidence.used["joint order"].startswith(f"{order}: bodies are 0.0 mm")
    assert f"links of {robot}," in file.evidence.used["joint order"]
    assert file.evidence.not_used == ("joint_vel",)
    assert_motion(file.motion(), motion, tolerance=1e-6)


def test_the_pelvis_alone_says_nothing_of_the_order_and_a_hand_does(npz, motion, isaac_angles):
    pelvis = {name: values[:, :1] for name, values in bodies(motion).items()}
    path = npz(joint_pos=isaac_angles, **pelvis)
    assert_motion(g1stream.load_motion(path), motion, tolerance=1e-6)
    calm = replace(motion, joint_pos=0.05 * motion.joint_pos)
    some = {name: values[:, [0, -1]] for name, values in bodies(calm).items()}
    npz(joint_pos=0.05 * isaac_angles, **some)
    assert_motion(g1stream.load_motion(path), calm, tolerance=1e-6)
    npz(joint_pos=0.05 * isaac_angles, **pelvis)
    with pytest.raises(MotionError) as refused:
        g1stream.load_motion(path)
    assert "--joint-order" in refused.value.remedy


def links(order):
    """The links as GMR's model or Isaac Lab lists them, with some that have no joint."""
    joints = [JOINT_LINKS[i] for i in (range(29) if order == "motor" else np.argsort(ISAACLAB))]
    return ["world", "pelvis", *joints[:6], "left_toe_link", *joints[6:], "head_mocap"]


JOINT_LINKS = [
    "torso_link" if name == "waist_pitch_joint" else name.replace("_joint", "_link")
    for name in g1stream.JOINT_NAMES
]


@pytest.mark.parametrize("name", ["link_body_list", "body_names"])
@pytest.mark.parametrize("order", ["motor", "isaaclab"])
@pytest.mark.parametrize("pose", ["none", "local", "wrong"])
def test_the_links_in_a_file_tell_the_order_of_a_calm_motion(npz, motion, name, order, pose):
    """All files of GMR have such a list, some of them positions in the pelvis's frame."""
    calm = replace(motion, joint_pos=0.05 * motion.joint_pos)
    at_origin = g1stream.Motion.from_arrays(calm.joint_pos, fps=50)
    more = {"local_body_pos": bodies(at_origin)["body_pos_w"]} if pose == "local" else {}
    if pose == "wrong":
        more = {"local_body_pos": np.zeros((3, 2))}
    columns = np.empty_like(calm.joint_pos)
    columns[:, ISAACLAB if order == "isaaclab" else range(29)] = calm.joint_pos
    listed = links("motor" if pose == "local" else order)  # the bodies themselves say more
    quat = calm.root_quat_wxyz[:, [1, 2, 3, 0]]
    path = npz(dof_pos=columns, root_pos=calm.root_pos, root_rot=quat, **more, **{name: listed})
    found = g1stream.load_motion(path)
    assert_motion(found, calm)
    assert found.warnings == ()
    assert opened(path).evidence.used["joint order"].startswith(order)


def test_limits_say_more_than_a_list_of_links(npz, motion, isaac_angles):
    """Such a list says how links are numbered; a violated limit says that joints are not so."""
    path = npz(dof=isaac_angles, link_body_list=links("motor"))
    assert_motion(g1stream.load_motion(path), motion, root=False)


@pytest.mark.parametrize("some", [["pelvis", "torso_link"], links("motor")[:20], []])
def test_a_list_of_some_links_tells_nothing(npz, motion, some):
    with pytest.raises(MotionError, match="ambiguous"):
        g1stream.load_motion(npz(dof=0.05 * motion.joint_pos, link_body_list=some))


def test_order_told_by_limits(npz, motion, isaac_angles):
    file = opened(npz(q=isaac_angles))
    assert file.evidence.assumed.keys() == {"pelvis"}
    found = file.motion()
    assert_motion(found, motion, root=False)
    assert not found.root_pos.any()


@pytest.mark.parametrize(
    ("order", "asked"), [("motor", False), ("isaaclab", False), ("isaaclab", True)]
)
def test_order_of_csv_without_header(tmp_path, motion, isaac_angles, order, asked):
    """Limits tell it; in calm motions it is taken to be motor order."""
    path = tmp_path / "motion.csv"
    angles = motion.joint_pos if order == "motor" else isaac_angles
    pose = np.hstack([motion.root_pos, xyzw_from_wxyz(motion.root_quat_wxyz)])
    np.savetxt(path, np.hstack([pose, angles]), "%.17g", delimiter=",")
    found = g1stream.load_motion(path, fps=50, joint_order=order if asked else None)
    assert_motion(found, motion)
    told = {text.split(": ")[1] for text in found.warnings}
    hint = {"the joint order was detected only by joint limits; isaaclab"}
    usual = order == "motor"
    assert told == (set() if usual else {"pelvis"} if asked else {"pelvis"} | hint)
    np.savetxt(path, np.hstack([pose, 0 * angles]), "%.17g", delimiter=",")
    assert opened(path).evidence.assumed.keys() == {"joint order", "pelvis", "frame rate"}


#: The joints in 23 columns without names.
OF_23 = {
    "motor": np.delete(np.arange(29), WRISTS),
    "motor-23dof": np.flatnonzero(G1.load("g1_23dof").present),
    "isaaclab": np.array([i for i in np.argsort(ISAACLAB) if i not in WRISTS]),
}


def without_names(path, motion, order, scale):
    """Write the joints of an order as a CSV without header; returns the motion in the file."""
    pose = np.hstack([motion.root_pos, xyzw_from_wxyz(motion.root_quat_wxyz)])
    columns = scale * motion.joint_pos[:, OF_23[order]]
    np.savetxt(path, np.hstack([pose, columns]), "%.17g", delimiter=",")
    expected = np.zeros_like(motion.joint_pos)
    expected[:, OF_23[order]] = columns
    return replace(motion, joint_pos=expected)


@pytest.mark.parametrize(
    ("order", "scale", "asked", "robot", "hints"),
    [
        ("motor", 1.0, None, None, 0),
        ("motor", 1.0, None, "g1_23dof", 0),
        ("motor-23dof", 1.0, None, None, 1),
        ("isaaclab", 1.0, None, None, 1),
        ("motor", 0.1, None, None, 1),
        ("motor-23dof", 0.1, None, "g1_23dof", 1),
        ("motor", 0.1, "motor", "g1_23dof", 0),
        ("motor-23dof", 0.1, "motor-23dof", None, 0),
        ("isaaclab", 0.1, "isaaclab", None, 0),
    ],
)
def test_which_23_joints_a_csv_has(tmp_path, motion, order, scale, asked, robot, hints):
    """Limits tell it; of a calm motion the flag does, or it is assumed to be the robot's."""
    path, assumed = tmp_path / "motion.csv", scale < 1.0 and not asked
    expected = without_names(path, motion, order, scale)
    file = find_motion(path, fps=50, joint_order=asked, robot=robot and G1.load(robot)).open()
    found, evidence = file.motion(), file.evidence
    assert_motion(found, expected)
    told = (evidence.assumed if assumed else evidence.used)["joint order"]
    assert told.startswith(order)
    warned = [text for text in found.warnings if "--joint-order" in text]
    assert len(warned) == hints
    if assumed:
        other = "motor" if robot else "motor-23dof"
        assert f"--joint-order {other} " in warned[0]


def test_an_order_of_23_joints_is_none_of_29(npz, motion):
    with pytest.raises(MotionError, match="23 joints"):
        g1stream.load_motion(npz(q=motion.joint_pos), joint_order="motor-23dof")


def test_limits_tell_the_23_joints_of_a_dance(tmp_path, real_clip):
    path = tmp_path / "dance.csv"
    expected = without_names(path, g1stream.load_motion(real_clip), "motor-23dof", 1.0)
    assert_motion(g1stream.load_motion(path), expected)
