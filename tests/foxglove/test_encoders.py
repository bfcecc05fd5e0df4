"""The derived channels, decoded by the official classes and followed as a viewer follows them."""

from io import StringIO

import numpy as np
import pytest
import yourdfpy
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from scipy.spatial.transform import Rotation

from g1stream.foxglove.encoders import MEASURED_PREFIX, JointStatesEncoder, TfEncoder, encode_log
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1

T0 = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def robot():
    return G1.default()


@pytest.fixture
def frames(robot):
    """Five random poses: stamps, joint_pos, root_pos, root_quat_wxyz."""
    rng = np.random.default_rng(5)
    quat = rng.normal(size=(5, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    joint_pos = rng.uniform(robot.lower, robot.upper, (5, 29))
    return T0 + 10_000_000 * np.arange(5), joint_pos, rng.normal(size=(5, 3)), quat


def matrices_in_world(message):
    """Follows a message's frames down from `world`, as a viewer does."""
    found = {"world": np.eye(4)}
    for transform in message.transforms:
        p, q = transform.translation, transform.rotation
        local = np.eye(4)
        local[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        local[:3, 3] = p.x, p.y, p.z
        assert transform.child_frame_id not in found
        found[transform.child_frame_id] = found[transform.parent_frame_id] @ local
    return found


@pytest.fixture(scope="module")
def urdf(robot):
    """The robot as yourdfpy, which knows nothing of ours, reads it."""
    return yourdfpy.URDF.load(StringIO(robot.urdf), load_meshes=False, build_scene_graph=True)


@pytest.mark.parametrize("prefix", ["", MEASURED_PREFIX])
def test_a_viewer_finds_every_link_where_yourdfpy_has_it(robot, urdf, frames, prefix):
    stamps, joint_pos, root_pos, root_quat = frames
    rows = TfEncoder(robot, prefix).encode(stamps, joint_pos, root_pos, root_quat)
    for t in range(5):
        urdf.update_cfg(dict(zip(robot.joint_names, joint_pos[t], strict=True)))
        root = np.eye(4)
        root[:3, :3] = Rotation.from_quat(np.roll(root_quat[t], -1)).as_matrix()
        root[:3, 3] = root_pos[t]
        world = matrices_in_world(FrameTransforms.FromString(rows[t].tobytes()))
        assert sorted(world) == sorted(["world", *(prefix + name for name in urdf.link_map)])
        for name in urdf.link_map:
            expected = root @ urdf.get_transform(name)
            np.testing.assert_allclose(world[prefix + name], expected, atol=1e-9)


def test_transforms_follow_the_tree_of_the_urdf_and_carry_their_stamp(robot, frames):
    stamps, *pose = frames
    rows = TfEncoder(robot).encode(stamps, *pose)
    message = FrameTransforms.FromString(rows[3].tobytes())
    parents = {t.child_frame_id: t.parent_frame_id for t in message.transforms}
    assert parents["pelvis"] == "world"
    assert parents["left_hip_pitch_link"] == "pelvis"
    assert parents["left_ankle_roll_link"] == "left_ankle_pitch_link"
    assert {t.timestamp.ToNanoseconds() for t in message.transforms} == {stamps[3]}


def test_the_robots_share_nothing_but_the_world(robot, frames):
    stamps, *pose = frames
    names = []
    for prefix in ("", MEASURED_PREFIX):
        row = TfEncoder(robot, prefix).encode(stamps, *pose)[0]
        message = FrameTransforms.FromString(row.tobytes())
        names.append({f for t in message.transforms for f in (t.child_frame_id, t.parent_frame_id)})
    assert names[0] & names[1] == {"world"}


def test_joint_states_are_in_motor_order(robot):
    rng = np.random.default_rng(6)
    q, dq, ddq, tau = rng.normal(size=(4, 3, 29))
    rows = JointStatesEncoder(robot).encode([T0, T0 + 1, T0 + 2], q, dq, ddq, tau)
    message = JointStates.FromString(rows[1].tobytes())
    assert message.timestamp.ToNanoseconds() == T0 + 1
    assert tuple(joint.name for joint in message.joints) == JOINT_NAMES
    np.testing.assert_array_equal([joint.position for joint in message.joints], q[1])
    np.testing.assert_array_equal([joint.velocity for joint in message.joints], dq[1])
    np.testing.assert_array_equal([joint.acceleration for joint in message.joints], ddq[1])
    np.testing.assert_array_equal([joint.effort for joint in message.joints], tau[1])


def test_a_log_line():
    message = Log.FromString(encode_log(T0 + 7, 3, "stream", "LowState is 120 ms old"))
    assert message.timestamp.ToNanoseconds() == T0 + 7
    assert message.level == Log.WARNING
    assert (message.name, message.message) == ("stream", "LowState is 120 ms old")
