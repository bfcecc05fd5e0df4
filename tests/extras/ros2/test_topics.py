"""What ROS 2 is given on DDS, decoded by cyclonedds with types of ROS 2 that are written here."""

import os
from collections import defaultdict
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState, Policy, Qos
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from scipy.spatial.transform import Rotation
from yourdfpy import URDF

from g1stream.app.record import record
from g1stream.app.sim import simulate
from g1stream.child_process import publishing_for_ros2
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import (
    LOWSTATE,
    REFERENCE,
    SPORTMODESTATE,
    LowState,
    Reference,
    SportModeState,
)
from g1stream.robot.model import G1

STEP = 10_000_000
T0 = 1_700_000_000_000_000_000
Q, DQ, TAU = (np.float32(np.random.default_rng(i).uniform(-0.4, 0.4, 29)) for i in range(3))
REFERENCE_Q = np.random.default_rng(5).uniform(-0.4, 0.4, 29)
POSITION = (1.0, 2.0, 0.75)
YAW = 0.5
DEPTH = 5000


def struct(typename, /, **fields):
    return make_idl_struct(typename.rpartition(".")[2], typename, fields)


def vector(name, axes):
    return struct(f"geometry_msgs.msg.dds_.{name}_", **dict.fromkeys(axes, float64))


TIME = struct("builtin_interfaces.msg.dds_.Time_", sec=int32, nanosec=uint32)
HEADER = struct("std_msgs.msg.dds_.Header_", stamp=TIME, frame_id=str)
POSE = struct(
    "geometry_msgs.msg.dds_.Transform_",
    translation=vector("Vector3", "xyz"),
    rotation=vector("Quaternion", "xyzw"),
)
STAMPED = struct(
    "geometry_msgs.msg.dds_.TransformStamped_", header=HEADER, child_frame_id=str, transform=POSE
)
TYPES = {
    "rt/tf": struct("tf2_msgs.msg.dds_.TFMessage_", transforms=sequence[STAMPED]),
    "rt/joint_states": struct(
        "sensor_msgs.msg.dds_.JointState_",
        header=HEADER,
        name=sequence[str],
        **dict.fromkeys(("position", "velocity", "effort"), sequence[float64]),
    ),
    "rt/robot_description": struct("std_msgs.msg.dds_.String_", data=str),
}


class Ros:
    """Subscribes as RViz does."""

    def __init__(self, participant):
        entity = participant.entity
        self._publications = BuiltinDataReader(entity, BuiltinTopicDcpsPublication)
        self._readers = {}
        for name, kind in TYPES.items():
            policies = [Policy.Reliability.Reliable(0), Policy.History.KeepLast(DEPTH)]
            if name == "rt/robot_description":
                policies.append(Policy.Durability.TransientLocal)
            topic = Topic(entity, name, kind)
            self._readers[name] = DataReader(entity, topic, Qos(*policies))

    def take(self, name):
        return [one for one in self._readers[name].take(DEPTH) if isinstance(one, TYPES[name])]

    def publications(self):
        """By topic, type name and QoS of each publisher there is, as discovered."""
        found = defaultdict(list)
        for one in self._publications.read(200):
            alive = one.sample_info.instance_state & InstanceState.Alive
            if alive and one.topic_name in TYPES:
                found[one.topic_name].append((one.type_name, one.qos))
        return found


class Robot:
    """Publishes a state, a position and a reference, over and over; the last turned by `YAW`."""

    def __init__(self, participant):
        self._writers = [
            RawWriter(participant, topic) for topic in (LOWSTATE, SPORTMODESTATE, REFERENCE)
        ]
        self._tick = 0

    def publish(self):
        self._tick += 1
        state, sport, target = LowState(), SportModeState(), Reference()
        state.q[:], state.dq[:], state.tau_est[:] = Q, DQ, TAU
        state.quaternion[:] = 1.0, 0.0, 0.0, 0.0
        sport.position[:] = POSITION
        target.q[:] = REFERENCE_Q
        target.root_quat_wxyz[:] = np.cos(YAW / 2), 0.0, 0.0, np.sin(YAW / 2)
        for writer, message in zip(self._writers, (state, sport, target), strict=True):
            writer.write(message.tobytes(), T0 + self._tick * STEP)


def make_config(domain_id):
    return Config.model_validate({"dds": {"domain": domain_id, "ros_tf": True}})


@pytest.fixture(scope="module")
def wire(module_domain_id):
    """A robot, who publishes it for ROS 2, and who subscribes there."""
    config = make_config(module_domain_id)
    with Participant(module_domain_id, "lo") as participant, publishing_for_ros2(config):
        yield Robot(participant), Ros(participant)


@pytest.fixture
def receive(wire, until):
    """Publishes until a message that fits comes back; returns it."""
    robot, ros = wire

    def wait(name, fits=lambda message: True):
        found = []

        def found_one():
            robot.publish()
            found.extend(message for message in ros.take(name) if fits(message))
            return found

        until(found_one, name)
        return found[-1]

    return wait


def poses(message):
    """By frame: its parent, its pose as a matrix, and its stamp."""
    found = {}
    for one in message.transforms:
        t, q = one.transform.translation, one.transform.rotation
        matrix = np.eye(4)
        matrix[:3, 3] = t.x, t.y, t.z
        matrix[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        stamp = one.header.stamp
        time = stamp.sec * 10**9 + stamp.nanosec
        found[one.child_frame_id] = one.header.frame_id, matrix, time
    return found


def in_frame(tree, root, frame):
    """The pose of a frame in another, from the parents in between."""
    matrix = np.eye(4)
    while frame != root:
        frame, pose, _ = tree[frame]
        matrix = pose @ matrix
    return matrix


@pytest.fixture(scope="module")
def urdf():
    """The default robot, read by somebody else's kinematics."""
    return URDF.load(StringIO(G1.default().urdf), load_meshes=False, build_scene_graph=True)


def by_urdf(urdf, q, link):
    names = G1.default().joint_names
    urdf.update_cfg(dict(zip(names, q.tolist(), strict=True)))
    return urdf.get_transform(link, "pelvis")


def of_frame(frame):
    """Whether a message has the pose of a frame, and begins with it."""
    return lambda message: message.transforms[0].child_frame_id == frame


def test_the_measured_robot_has_the_frames_of_its_links(receive, urdf):
    tree = {}

    def aligned(message):
        tree.update(poses(message) if of_frame("pelvis")(message) else {})
        return tree and abs(tree["pelvis"][1][0, 1]) > 0.1  # with the first reference

    receive("rt/tf", aligned)
    assert tree.keys() == set(urdf.link_map)
    parent, pelvis, time = tree["pelvis"]
    assert parent == "world"
    assert time > T0
    assert (time - T0) % STEP == 0
    np.testing.assert_allclose(pelvis[:3, 3], POSITION, atol=1e-6)
    np.testing.assert_allclose(pelvis[:3, 0], [np.cos(YAW), np.sin(YAW), 0.0], atol=1e-6)
    for link in ("left_ankle_roll_link", "right_wrist_yaw_link", "torso_link"):
        found = in_frame(tree, "pelvis", link)
        np.testing.assert_allclose(found, by_urdf(urdf, Q, link), atol=1e-6)


def test_the_joint_states_are_those_measured(receive):
    message = receive("rt/joint_states")
    assert tuple(message.name) == G1.default().joint_names
    for values, expected in ((message.position, Q), (message.velocity, DQ), (message.effort, TAU)):
        np.testing.assert_array_equal(values, expected.astype(float))
    assert message.header.frame_id == ""
    assert (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec - T0) % STEP == 0


def test_the_ghost_has_the_joints_of_the_reference_on_the_measured_pelvis(receive, urdf):
    tree = poses(receive("rt/tf", of_frame("ghost/pelvis")))
    assert tree.keys() == {f"ghost/{link}" for link in urdf.link_map}
    assert tree["ghost/pelvis"][0] == "pelvis"
    np.testing.assert_array_equal(tree["ghost/pelvis"][1], np.eye(4))
    for link in ("left_ankle_roll_link", "right_wrist_yaw_link"):
        found = in_frame(tree, "pelvis", f"ghost/{link}")
        np.testing.assert_allclose(found, by_urdf(urdf, REFERENCE_Q, link), atol=1e-9)


def test_who_subscribes_late_gets_the_description(receive, module_domain_id, until, urdf):
    receive("rt/tf")
    with Participant(module_domain_id, "lo") as late:
        ros, received = Ros(late), []
        until(lambda: received or received.extend(ros.take("rt/robot_description")), "the URDF")
    (message,) = received
    assert message.data == G1.default().urdf
    shapes = [v.geometry for link in urdf.link_map.values() for v in link.visuals]
    assert shapes
    assert not any(shape.mesh for shape in shapes)  # RViz would look for files


def test_topics_types_and_qos_are_announced_as_ros_announces_them(receive, wire):
    receive("rt/tf")
    announced = wire[1].publications()
    assert {name: [kind for kind, _ in found] for name, found in announced.items()} == {
        "rt/tf": ["tf2_msgs::msg::dds_::TFMessage_"],
        "rt/joint_states": ["sensor_msgs::msg::dds_::JointState_"],
        "rt/robot_description": ["std_msgs::msg::dds_::String_"],
    }
    for name, ((_, qos),) in announced.items():
        latched = name == "rt/robot_description"
        kept = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
        assert kept in qos
        assert qos[Policy.Reliability].max_blocking_time == 0
        assert isinstance(qos[Policy.History], Policy.History.KeepLast)


def children():
    text = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
    return set(map(int, text.split()))


def test_nothing_is_published_unless_asked(domain_id):
    before = children()
    with publishing_for_ros2(Config.model_validate({"dds": {"domain": domain_id}})):
        assert children() == before


def test_sim_and_record_publish(domain_id, tmp_path, until):
    config = make_config(domain_id)
    with Participant(domain_id, "lo") as participant:
        ros = Ros(participant)
        simulate(config, should_stop=ros.publications)
        until(lambda: not ros.publications(), "the end of the publisher")
        record(tmp_path / "session.mcap", config, should_stop=ros.publications)
