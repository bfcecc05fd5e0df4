import math
import struct
from io import StringIO

import numpy as np
import pytest
import yourdfpy
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from g1stream.robot.model import G1
from g1stream.view.encoders import (
    MEASURED_PREFIX,
    JointStatesTemplate,
    TransformsEncoder,
)

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


def test_link_poses_match_yourdfpy(robot, frames):
    urdf = yourdfpy.URDF.load(StringIO(robot.urdf), load_meshes=False, build_scene_graph=True)
    stamps, joint_pos, root_pos, root_quat = frames
    rows = TransformsEncoder(robot, MEASURED_PREFIX).encode(stamps, joint_pos, root_pos, root_quat)
    for t in range(5):
        urdf.update_cfg(dict(zip(robot.joint_names, joint_pos[t], strict=True)))
        root = np.eye(4)
        root[:3, :3] = Rotation.from_quat(np.roll(root_quat[t], -1)).as_matrix()
        root[:3, 3] = root_pos[t]
        world = matrices_in_world(FrameTransforms.FromString(rows[t].tobytes()))
        assert sorted(world) == sorted(
            ["world", *(MEASURED_PREFIX + name for name in urdf.link_map)]
        )
        for name in urdf.link_map:
            expected = root @ urdf.get_transform(name)
            np.testing.assert_allclose(world[MEASURED_PREFIX + name], expected, atol=1e-9)


def test_transforms_have_the_parents_of_the_urdf_and_their_timestamp(robot, frames):
    stamps, *pose = frames
    rows = TransformsEncoder(robot).encode(stamps, *pose)
    message = FrameTransforms.FromString(rows[3].tobytes())
    parents = {t.child_frame_id: t.parent_frame_id for t in message.transforms}
    assert parents["pelvis"] == "world"
    assert parents["left_hip_pitch_link"] == "pelvis"
    assert parents["left_ankle_roll_link"] == "left_ankle_pitch_link"
    assert {t.timestamp.ToNanoseconds() for t in message.transforms} == {stamps[3]}


# --- templates ---

JOINTS = ["left_hip_pitch_joint", "hüfte", "骨盆"]
FIELDS = ("position", "velocity", "acceleration", "effort")

stamps = st.integers(min_value=0, max_value=2**63 - 1)
doubles = st.floats(width=64, allow_nan=True, allow_infinity=True)


def bits(value: float) -> bytes:
    """Compares -0.0 and NaN as what they are."""
    return struct.pack("<d", value)


@given(stamp=stamps, values=arrays(np.float64, (4, len(JOINTS)), elements=doubles))
@example(stamp=0, values=np.zeros((4, 3)))
@example(stamp=2**31 * 1_000_000_000, values=np.full((4, 3), np.nan))
@example(stamp=2**63 - 1, values=np.full((4, 3), -np.inf))
@example(stamp=1_700_000_000_999_999_999, values=np.full((4, 3), 5e-324))
def test_joint_states_decode_to_the_input(stamp, values):
    rows = JointStatesTemplate(JOINTS, FIELDS).encode([stamp], *values[:, np.newaxis])
    message = JointStates.FromString(rows[0].tobytes())
    assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == stamp
    assert [joint.name for joint in message.joints] == JOINTS
    for i, joint in enumerate(message.joints):
        assert all(joint.HasField(field) for field in FIELDS)
        assert [bits(getattr(joint, field)) for field in FIELDS] == [bits(v) for v in values[:, i]]


def test_many_joints_do_not_confuse_the_placeholders():
    names = [f"joint_{i}" for i in range(400)]
    values = np.arange(800.0).reshape(2, 1, 400) + math.pi
    rows = JointStatesTemplate(names, ("position", "velocity")).encode([7], *values)
    joints = JointStates.FromString(rows[0].tobytes()).joints
    np.testing.assert_array_equal([j.position for j in joints], values[0, 0])
    np.testing.assert_array_equal([j.velocity for j in joints], values[1, 0])
