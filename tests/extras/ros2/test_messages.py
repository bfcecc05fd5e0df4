"""ROS's messages against types that are written out here, and serialised by Cyclone DDS."""

from dataclasses import dataclass

import pytest
from cyclonedds.core import Policy, Qos
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.extras.ros2.messages import joint_state, tf_message
from g1stream.extras.ros2.topics import JOINT_STATES, ROBOT_DESCRIPTION, TF
from g1stream.session.format import encode_string
from g1stream.session.recorded_motion import FramePose

T = 1_700_000_000_123_456_789
LATER = T + 2 * 10**9 + 5
TRANSIENT = Qos(
    Policy.Reliability.Reliable(0), Policy.Durability.TransientLocal, Policy.History.KeepLast(1)
)
VOLATILE = Qos(Policy.Reliability.Reliable(0), Policy.History.KeepLast(100))


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs.msg.dds_.TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


def header(frame="", time=T):
    return Header(Time(*divmod(time, 10**9)), frame)


def transform(time, parent, child, x):
    rotation = Quaternion(x=0.1, y=0.2, z=0.3, w=x)
    pose = Transform(Vector3(x, 2.0, -3.0), rotation)
    return TransformStamped(header(parent, time), child, pose)


MESSAGES = {
    "string": (
        ROBOT_DESCRIPTION,
        encode_string("<robot é />"),
        String("<robot é />"),
    ),
    "tf": (
        TF,
        tf_message(
            [
                FramePose(T, "world", "pelvis", (1.0, 2.0, -3.0), (1.0, 0.1, 0.2, 0.3)),
                FramePose(LATER, "pelvis", "x", (5.0, 2.0, -3.0), (5.0, 0.1, 0.2, 0.3)),
            ]
        ),
        TFMessage([transform(T, "world", "pelvis", 1.0), transform(LATER, "pelvis", "x", 5.0)]),
    ),
    "no tf": (TF, tf_message([]), TFMessage([])),
    "joint state": (
        JOINT_STATES,
        joint_state(T, ("a", "knee"), [1.0, 2.0], [], [3.0, -4.0]),
        JointState(header(), ["a", "knee"], [1.0, 2.0], [], [3.0, -4.0]),
    ),
}


@pytest.mark.parametrize(("topic", "data", "expected"), MESSAGES.values(), ids=MESSAGES)
def test_bytes_are_those_of_cyclone_dds(topic, data, expected):
    assert data == expected.serialize()


@pytest.mark.parametrize(("topic", "data", "expected"), MESSAGES.values(), ids=MESSAGES)
def test_a_reader_of_the_same_types_receives_it(domain_id, until, topic, data, expected):
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as other:
        writer = RawWriter(ours, topic, topic.depth, latched=topic.latched)
        where = Topic(other.entity, topic.name, type(expected))
        reader = DataReader(other.entity, where, VOLATILE)
        until(lambda: writer.matched, "the reader")
        writer.write(data)
        received = []
        until(lambda: received or received.extend(reader.take()), "the message")
        assert received == [expected]


def test_the_description_alone_is_kept_for_readers_that_come_later(domain_id, until):
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as other:
        writers = [
            RawWriter(ours, topic, topic.depth, latched=topic.latched)
            for topic in (ROBOT_DESCRIPTION, JOINT_STATES)
        ]
        for text in ("old", "new"):
            writers[0].write(encode_string(text))
        writers[1].write(MESSAGES["joint state"][1])
        late = DataReader(
            other.entity, Topic(other.entity, "rt/robot_description", String), TRANSIENT
        )
        joints = Topic(other.entity, "rt/joint_states", JointState)
        _refused = DataReader(other.entity, joints, TRANSIENT)
        volatile = DataReader(other.entity, joints, VOLATILE)
        received = []
        until(lambda: received or received.extend(late.take()), "the description")
        until(lambda: writers[1].matched, "the volatile reader")
        assert received == [String("new")]
        assert not late.take()
        assert writers[1].matched == 1
        assert not volatile.take()
