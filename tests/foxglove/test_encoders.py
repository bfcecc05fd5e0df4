"""The derived channels, decoded by the official classes and followed as a viewer follows them."""

from io import StringIO

import numpy as np
import pytest
import yourdfpy
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from scipy.spatial.transform import Rotation

from g1stream.foxglove.encoders import MEASURED_PREFIX, TransformsEncoder, encode_log
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
def test_link_poses_match_yourdfpy(robot, urdf, frames, prefix):
    stamps, joint_pos, root_pos, root_quat = frames
    rows = TransformsEncoder(robot, prefix).encode(stamps, joint_pos, root_pos, root_quat)
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


def test_transforms_have_the_parents_of_the_urdf_and_their_timestamp(robot, frames):
    stamps, *pose = frames
    rows = TransformsEncoder(robot).encode(stamps, *pose)
    message = FrameTransforms.FromString(rows[3].tobytes())
    parents = {t.child_frame_id: t.parent_frame_id for t in message.transforms}
    assert parents["pelvis"] == "world"
    assert parents["left_hip_pitch_link"] == "pelvis"
    assert parents["left_ankle_roll_link"] == "left_ankle_pitch_link"
    assert {t.timestamp.ToNanoseconds() for t in message.transforms} == {stamps[3]}


def test_reference_and_measured_frames_share_only_the_world(robot, frames):
    stamps, *pose = frames
    names = []
    for prefix in ("", MEASURED_PREFIX):
        row = TransformsEncoder(robot, prefix).encode(stamps, *pose)[0]
        message = FrameTransforms.FromString(row.tobytes())
        names.append({f for t in message.transforms for f in (t.child_frame_id, t.parent_frame_id)})
    assert names[0] & names[1] == {"world"}


def test_log_message():
    message = Log.FromString(encode_log(T0 + 7, 3, "stream", "LowState is 120 ms old"))
    assert message.timestamp.ToNanoseconds() == T0 + 7
    assert message.level == Log.WARNING
    assert (message.name, message.message) == ("stream", "LowState is 120 ms old")
