import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.robot.kinematics import forward_kinematics, local_transforms
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_mul, quat_rotate

METRES = RADIANS = 1e-9


def angle_between(quat, other):
    """rad, by scipy."""
    turns = (Rotation.from_quat(q.reshape(-1, 4), scalar_first=True) for q in (quat, other))
    return (next(turns).inv() * next(turns)).magnitude()


@pytest.mark.parametrize("kind", ["default", "tilted axes", "with hands"])
def test_every_link_is_where_mujoco_has_it(
    robot, load, reference_urdf, random_frames, compile_mujoco, kind
):
    if kind == "tilted axes":
        robot = load(robot.urdf.replace('<axis xyz="0 1 0"', '<axis xyz="0.48 -0.6 0.64"'))
    elif kind == "with hands":
        robot = G1.load(reference_urdf("g1_29dof_with_hand_rev_1_0.urdf"))
    model = compile_mujoco(robot.urdf)
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in robot.joint_names]
    bodies = [model.body(name).id for name in robot.link_names]
    poses = forward_kinematics(robot, *random_frames)
    for frame, (joint_pos, root_pos, root_quat) in enumerate(zip(*random_frames, strict=True)):
        data.qpos[:3], data.qpos[3:7], data.qpos[joints] = root_pos, root_quat, joint_pos
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(poses.pos[frame], data.xpos[bodies], rtol=0, atol=METRES)
        turn = angle_between(poses.quat_wxyz[frame], data.xquat[bodies])
        np.testing.assert_array_less(turn, RADIANS)


def test_local_transforms_compose_to_the_world(robot, random_frames):
    local = local_transforms(robot, *random_frames)
    world = forward_kinematics(robot, *random_frames)
    np.testing.assert_array_equal(local.pos[:, 0], random_frames.root_pos)
    np.testing.assert_array_equal(local.quat_wxyz[:, 0], random_frames.root_quat_wxyz)
    for link, up in list(enumerate(robot.parent))[1:]:
        pos = world.pos[:, up] + quat_rotate(world.quat_wxyz[:, up], local.pos[:, link])
        quat = quat_mul(world.quat_wxyz[:, up], local.quat_wxyz[:, link])
        np.testing.assert_allclose(world.pos[:, link], pos, atol=1e-12)
        np.testing.assert_array_less(angle_between(world.quat_wxyz[:, link], quat), 1e-12)


def test_one_root_pose_serves_all_frames(robot, random_frames):
    root_pos, root_quat = random_frames.root_pos[3], random_frames.root_quat_wxyz[3]
    poses = forward_kinematics(robot, random_frames.joint_pos, root_pos, root_quat)
    one_by_one = forward_kinematics(
        robot, random_frames.joint_pos, np.tile(root_pos, (12, 1)), np.tile(root_quat, (12, 1))
    )
    np.testing.assert_array_equal(poses.pos, one_by_one.pos)


@pytest.mark.parametrize("shape", [(29,), (12, 28)])
def test_joint_positions_of_another_shape_are_refused(robot, random_frames, shape):
    with pytest.raises(ValueError, match="29"):
        forward_kinematics(robot, np.zeros(shape), *random_frames[1:])


def test_root_poses_of_another_length_are_refused(robot, random_frames):
    with pytest.raises(ValueError, match="shape"):
        forward_kinematics(robot, random_frames.joint_pos, random_frames.root_pos[:5],
                           random_frames.root_quat_wxyz)  # fmt: skip


def test_links_that_are_asked_for_alone_are_where_they_are_with_all(robot, random_frames):
    links = [robot.link_index(name) for name in ("left_ankle_roll_link", "head_link")]
    poses, some = (forward_kinematics(robot, *random_frames, asked) for asked in (None, links))
    np.testing.assert_array_equal(some.pos[:, links], poses.pos[:, links])
    np.testing.assert_array_equal(some.quat_wxyz[:, links], poses.quat_wxyz[:, links])
    assert np.isnan(some.pos[:, robot.link_index("right_rubber_hand")]).all()
