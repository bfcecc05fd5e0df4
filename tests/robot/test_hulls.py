import os
import tempfile
from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from g1stream.motion.readers import load_motion
from g1stream.robot.dynamics import mujoco_spec
from g1stream.robot.hulls import Hull, SelfCollision, add_hulls, never_collide, read_hulls
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1, REVISIONS

PEERS = Path(os.environ.get("PEERS") or Path(tempfile.gettempdir(), "peers"))
SCENE = PEERS / "unitree_mujoco/unitree_robots/g1/scene_29dof.xml"
HANDS = ("left_rubber_hand", "right_rubber_hand")
RNG = np.random.default_rng(10)
UPRIGHT = (np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))


def box(link, half_size):
    corners = np.array(np.meshgrid(*[(-size, size) for size in half_size])).reshape(3, -1).T
    return Hull(link, True, corners)


def reach(points, directions):
    """How far points reach in each direction."""
    return (points @ directions.T).max(axis=0)


@pytest.mark.parametrize("revision", REVISIONS)
def test_moving_links_have_hulls(revision):
    robot = G1.load(revision)
    hulls = read_hulls(robot)
    solid = {hull.link for hull in hulls if hull.solid}
    limbs = [name for name in JOINT_NAMES if "waist_yaw" not in name and "waist_roll" not in name]
    assert {name.replace("_joint", "_link") for name in limbs} - {"waist_pitch_link"} <= solid
    assert "torso_link" in solid
    for hull in hulls:
        assert not hull.vertices.flags.writeable
        assert 8 <= len(hull.vertices) <= 400, hull.link
        assert np.abs(hull.vertices).max() < 0.6, hull.link


@pytest.mark.slow
def test_hulls_fit_the_meshes_of_their_links(robot, reference_urdf):
    meshes = reference_urdf("g1_29dof_rev_1_0.urdf").parents[1] / "meshes"
    directions = RNG.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    compared = 0
    for hull in read_hulls(robot):
        file = "torso_link_rev_1_0" if hull.link == "torso_link" else hull.link
        sole = hull.link.endswith("ankle_roll_link") and hull.solid
        if sole or "shoulder_pitch" in file or "shoulder_roll" in file:
            continue  # Unitree's spheres and cylinders, not the meshes
        mesh = trimesh.load(meshes / f"{file}.STL").convex_hull
        beyond = reach(mesh.vertices, directions) - reach(hull.vertices, directions)
        assert beyond.min() > -2e-6, hull.link
        assert beyond.max() < 0.51e-3, hull.link
        own = trimesh.PointCloud(hull.vertices).convex_hull.volume
        assert 0.97 < own / mesh.volume < 1.0, hull.link
        compared += 1
    assert compared == 28


def depths(collision, pose):
    """By pair of links that touch in a pose."""
    found = collision.depths(pose[np.newaxis])
    return {pair: depth.item() for pair, depth in found.items()}


def test_depth_is_the_way_apart(robot):
    pos, quat = forward_kinematics(robot, np.zeros((1, N_JOINTS)), *UPRIGHT)
    left, right = (robot.link_index(hand) for hand in HANDS)
    assert np.abs(quat[0, [left, right], 1:]).max() < 0.01
    apart = pos[0, left, 1] - pos[0, right, 1]
    for overlap in (0.004, -0.004):
        boxes = [box(hand, (0.05, (apart + overlap) / 2, 0.05)) for hand in HANDS]
        found = depths(SelfCollision(robot, boxes), np.zeros(N_JOINTS))
        if overlap < 0:
            assert found == {}
        else:
            assert found == {HANDS: pytest.approx(overlap, abs=2e-4)}


@pytest.mark.parametrize("name", [*REVISIONS, "g1_23dof"])
def test_links_with_one_joint_between_or_none_never_collide(name):
    robot = G1.load(name)
    model = mujoco_spec(robot, floating=True, shapes=False).compile()

    def near(pair):
        upper, lower = sorted(model.body_weldid[model.body(link).id] for link in pair)
        return upper in (lower, model.body_weldid[model.body_parentid[lower]])

    # Two joints lie between them, and the foot's outline reaches around the ankle.
    around = {(f"{side}_knee_link", f"{side}_ankle_roll_link") for side in ("left", "right")}
    assert never_collide(robot) == around.union(filter(near, combinations(robot.link_names, 2)))
    assert depths(SelfCollision(robot), np.zeros(N_JOINTS)) == {}


def deepest(model, data):
    """The depth of the deepest contact of each pair of links, m."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    found: dict[frozenset[str], float] = {}
    for geoms, distance in zip(data.contact.geom, data.contact.dist, strict=True):
        pair = frozenset(model.body(model.geom_bodyid[geom]).name for geom in geoms)
        found[pair] = max(found.get(pair, 0.0), -distance)
    return found


@pytest.mark.skipif(not SCENE.exists(), reason="unitree_mujoco is not set up in PEERS")
def test_dance_touches_itself_as_in_unitree_mujoco(real_clip):
    """The same links in the same frames, none deeper, and shallower by twice 0.5 mm at most."""
    robot = G1.load("g1_29dof")
    collision = SelfCollision(robot, [hull for hull in read_hulls(robot) if hull.solid])
    model = mujoco.MjModel.from_xml_path(str(SCENE))
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in JOINT_NAMES]
    compared = 0
    for pose in load_motion(real_clip).joint_pos[:600]:
        data.qpos[2], data.qpos[joints] = 5.0, pose
        theirs = deepest(model, data)
        ours = {frozenset(pair): depth for pair, depth in depths(collision, pose).items()}
        assert ours.keys() <= theirs.keys()
        for pair, depth in theirs.items():
            assert -0.001 < ours.get(pair, 0.0) - depth < 0.0002, pair
            compared += 1
    assert compared > 80


def test_depths_are_those_of_the_contacts_that_mujoco_has_in_each_pose(robot):
    """Also where links touch in several points, or with several hulls."""
    spec = mujoco_spec(robot, floating=True, shapes=False)
    add_hulls(spec, read_hulls(robot), never_collide(robot), contact_bit=1)
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in JOINT_NAMES]
    poses = RNG.uniform(robot.lower, robot.upper, (40, N_JOINTS))
    found = SelfCollision(robot).depths(poses)
    assert list(found) == sorted(found, key=lambda pair: [robot.link_index(one) for one in pair])
    several = 0
    for k, pose in enumerate(poses):
        data.qpos[joints] = pose
        theirs = deepest(model, data)
        several += data.ncon - len(theirs)
        assert {frozenset(pair): depth[k] for pair, depth in found.items() if depth[k]} == theirs
    assert several > 10
