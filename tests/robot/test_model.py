import subprocess
import sys
from dataclasses import fields
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from g1stream.errors import ConfigError, RobotError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1, REVISIONS, VARIANTS


def assert_same_model(a, b):
    for field in fields(G1):
        if field.name not in ("source", "urdf"):
            np.testing.assert_array_equal(
                getattr(a, field.name), getattr(b, field.name), err_msg=field.name
            )


def test_the_default_robot_and_motions_need_no_heavy_import():
    code = (
        "import sys; from g1stream.motion.readers import load_motion; load_motion('demo');"
        "from g1stream.robot.model import G1; G1.default(); print(sorted(set(sys.modules) & "
        "{'yourdfpy', 'trimesh', 'scipy', 'mujoco', 'lxml', 'matplotlib', 'cyclonedds'}))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_loading_the_default_by_path_gives_the_same_tree(robot, load, tmp_path):
    loaded = load(robot.urdf)
    assert loaded.source == str(tmp_path / "some.urdf")
    assert_same_model(loaded, robot)


def test_an_unknown_link_is_named_with_the_known_ones(robot):
    assert robot.link_names[robot.link_index("torso_link")] == "torso_link"
    with pytest.raises(RobotError, match=r"'tors'.*torso_link"):
        robot.link_index("tors")


def test_both_revisions_are_loaded_by_name(robot):
    default, other = (G1.load(name) for name in REVISIONS)
    assert_same_model(default, robot)
    assert (other.link_names, other.joint_names) == (robot.link_names, robot.joint_names)
    torso = other.link_index("waist_roll_link")
    assert other.origin_pos[torso].tolist() == [-0.0039635, 0.0, 0.035]


def test_fingers_are_held_at_zero_and_named(reference_urdf):
    with_hands = G1.load(reference_urdf("g1_29dof_with_hand_rev_1_0.urdf"))
    assert with_hands.joint_names == JOINT_NAMES
    assert len(with_hands.ignored_joints) == 14
    assert all("_hand_" in name for name in with_hands.ignored_joints)
    thumb = with_hands.link_index("left_hand_thumb_1_link")
    assert with_hands.joint_of_link[thumb] == -1


def test_unitrees_own_urdf_is_the_default_robot(robot, reference_urdf):
    """Meshes it names are not there under these paths, and need not be."""
    theirs = G1.load(reference_urdf("g1_29dof_rev_1_0.urdf"))
    assert theirs.name == "g1_29dof_rev_1_0"
    assert_same_model(theirs, robot)


def test_order_of_elements_does_not_matter(robot, load):
    """Joints before links, children before parents: the tree is the same up to the order."""
    root = ET.fromstring(robot.urdf)
    root[:] = reversed(root)
    turned = load(ET.tostring(root, encoding="unicode"))
    assert set(turned.link_names) == set(robot.link_names)
    for name in robot.link_names[1:]:
        ours, theirs = robot.link_index(name), turned.link_index(name)
        assert turned.parent[theirs] < theirs
        np.testing.assert_array_equal(turned.origin_pos[theirs], robot.origin_pos[ours])
        assert robot.link_names[robot.parent[ours]] == turned.link_names[turned.parent[theirs]]


def test_limits_of_a_urdf_that_are_wider_than_a_robots_are_narrowed(load, robot):
    """And those that are narrower are kept."""
    root = ET.fromstring(robot.urdf)
    wider, narrower = JOINT_NAMES[3], JOINT_NAMES[12]
    for name, *limits in ((wider, -9, 9, 900, 5000), (narrower, -1, 1, 5, 20)):
        limit = root.find(f"joint[@name='{name}']/limit").attrib
        limit.update(zip(("lower", "upper", "velocity", "effort"), map(str, limits), strict=True))
    urdf = ET.tostring(root, encoding="unicode")
    loaded, own = load(urdf), load(urdf, own_limits=True)
    for name in ("lower", "upper", "velocity", "effort"):
        widest = max if name != "lower" else min
        builtin = [getattr(G1.load(revision), name) for revision in REVISIONS]
        assert getattr(loaded, name)[3] == widest(limit[3] for limit in builtin)
        assert getattr(loaded, name)[12] == getattr(own, name)[12]
    assert (own.upper[3], own.velocity[3], own.effort[3]) == (9.0, 900.0, 5000.0)
    assert (loaded.capped, own.capped) == ((wider,), ())
    assert wider in loaded.warning
    assert own.warning == ""


def test_a_range_outside_that_of_a_g1_is_refused(load, robot):
    root = ET.fromstring(robot.urdf)
    root.find("joint[@name='left_elbow_joint']/limit").attrib.update(lower="3", upper="4")
    urdf = ET.tostring(root, encoding="unicode")
    with pytest.raises(RobotError, match="left_elbow_joint"):
        load(urdf)
    assert load(urdf, own_limits=True).lower[18] == 3.0


@pytest.fixture(params=VARIANTS)
def variant(request) -> G1:
    return G1.load(request.param)


def test_a_g1_with_fewer_joints_is_the_default_one_with_the_others_fixed_at_zero(variant, robot):
    present = variant.present
    assert set(variant.joint_of_link) == {-1, *np.flatnonzero(present)}
    for name in ("lower", "upper", "velocity", "effort"):
        assert (getattr(variant, name) == getattr(robot, name))[present].all()
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (3, 29))
    q[:, JOINT_NAMES.index("waist_yaw_joint")] = 0.0  # its axis is elsewhere with 23 joints
    base = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    own, whole = (
        forward_kinematics(variant, q, *base),
        forward_kinematics(robot, q * present, *base),
    )
    waist = [i for i, name in enumerate(robot.link_names) if name.startswith("waist")]
    np.testing.assert_allclose(
        np.delete(own.pos, waist, 1), np.delete(whole.pos, waist, 1), atol=1e-12
    )
    again = G1.from_urdf(variant.urdf, "again")
    assert again.joint_set is variant.joint_set
    assert again.name == variant.joint_set.name
    assert not variant.capped


def test_a_selection_has_none_of_the_joints_that_a_robot_lacks(variant):
    assert variant.select(None).tolist() == variant.present.tolist()
    assert (variant.select("arms") <= variant.present).all()


def test_a_selection_of_what_a_robot_lacks_is_refused():
    with pytest.raises(ConfigError, match="g1_dual_arm"):
        G1.load("g1_dual_arm").select("legs")


def test_a_urdf_that_knows_23_joints_only_is_read(load, robot):
    root = ET.fromstring(robot.urdf)
    gone = {"waist_roll_joint", "waist_pitch_joint"}
    gone |= {f"{s}_wrist_{p}_joint" for s in ("left", "right") for p in ("pitch", "yaw")}
    for joint in root.iter("joint"):
        if joint.get("name") in gone:
            joint.set("type", "fixed")
            joint.set("name", f"{joint.get('name')}_fixed")
    own = load(ET.tostring(root, encoding="unicode"))
    assert own.joint_set.mode_machine == 4
    assert not own.capped


def test_the_figures_of_unitrees_23_joint_robot():
    """Against g1_23dof_rev_1_0.urdf: the axis of the waist, and the mass of a hand."""
    small = G1.load("g1_23dof")
    yaw = np.zeros((1, 29))
    yaw[0, JOINT_NAMES.index("waist_yaw_joint")] = np.pi
    turned = forward_kinematics(small, yaw, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    torso = turned.pos[0, small.link_index("torso_link")]
    np.testing.assert_allclose(torso, [-0.0039635, 0.0, 0.044], atol=1e-12)
    masses = {
        link.get("name"): float(mass.get("value"))
        for link in small.xml.findall("link")
        if (mass := link.find("inertial/mass")) is not None
    }
    hand = [mass for name, mass in masses.items() if "left_wrist" in name or "left_rubber" in name]
    assert sum(hand) == pytest.approx(0.35692864 + 3e-3)
    assert masses["torso_link"] == 6.78
