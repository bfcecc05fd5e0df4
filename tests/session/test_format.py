import re

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.records import Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.decoder import DecoderFactory

from g1stream.dds.messages import TOPICS
from g1stream.session.format import CHANNELS, metadata_from_strings, metadata_to_strings
from g1stream.view.encoders import JointStatesTemplate

WIRE = [channel for channel in CHANNELS.values() if channel.dds_topic]
TOPIC = {topic.name: topic for topic in TOPICS}
PROTOBUF = {c.schema_name: c for c in CHANNELS.values() if c.schema_name.startswith("foxglove.")}


def flat(message):
    """The figures of a cyclonedds sample or a decoded message, in the order of the fields."""
    if isinstance(message, (int, float)):
        return [message]
    names = getattr(message, "__slots__", None) or getattr(message, "__dict__", None)
    items = message if names is None else [getattr(message, name) for name in names]
    return [figure for item in items for figure in flat(item)]


@pytest.mark.parametrize("channel", WIRE, ids=lambda c: c.topic)
def test_ros2_decoders_read_what_cyclonedds_serialises(channel, make_sample):
    schema = Schema(1, channel.build_schema(), channel.schema_encoding, channel.schema_name)
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    sent = make_sample(TOPIC[channel.dds_topic])
    found = decode(sent.serialize())
    for name in ("state_published", "state_received"):
        if hasattr(found, name):
            low, high = getattr(found, name)
            setattr(found, name, low + (high << 32))
    assert flat(found) == flat(sent)


@pytest.mark.parametrize("channel", CHANNELS.values(), ids=lambda c: c.topic)
def test_no_field_holds_more_than_a_double_does_but_counts(channel):
    """PlotJuggler refuses a file with a number that no double holds, such as ns since 1970."""
    if channel.message_encoding == "cdr" and channel.topic != "/policy/terms":  # of an extra
        large = re.findall(r"u?int64(?:\[\d*\])? (\w+)", channel.build_schema().decode())
        assert set(large) <= {"tick"}


def test_encodings_are_mcaps_well_known_ones():
    for channel in CHANNELS.values():
        pair = (channel.schema_encoding, channel.message_encoding)
        if channel.schema_name.startswith("foxglove."):
            assert pair == (SchemaEncoding.Protobuf, MessageEncoding.Protobuf)
        else:
            assert pair == (SchemaEncoding.ROS2, MessageEncoding.CDR)
        assert channel.description


def test_wire_channels_are_named_as_ros_names_them():
    assert {c.dds_topic: (c.topic, c.schema_name) for c in WIRE} == {
        "rt/lowcmd": ("/lowcmd", "unitree_hg/msg/LowCmd"),
        "rt/arm_sdk": ("/arm_sdk", "unitree_hg/msg/LowCmd"),
        "rt/lowstate": ("/lowstate", "unitree_hg/msg/LowState"),
        "rt/sportmodestate": ("/sportmodestate", "unitree_go/msg/SportModeState"),
        "rt/odommodestate": ("/odommodestate", "unitree_go/msg/SportModeState"),
        "rt/secondary_imu": ("/secondary_imu", "unitree_hg/msg/IMUState"),
        "rt/g1stream/reference": ("/reference", "g1stream/msg/Reference"),
        "rt/g1stream/policy": ("/policy", "g1stream/msg/Policy"),
    }


@pytest.mark.parametrize("channel", PROTOBUF.values(), ids=PROTOBUF)
def test_protobuf_schemas_stand_alone(channel):
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(channel.build_schema()).file:
        pool.Add(file)
    assert pool.FindMessageTypeByName(channel.schema_name).fields


@pytest.mark.parametrize(
    ("topic", "fields"),
    [
        ("/measured/joint_states", ("position", "velocity", "acceleration", "effort")),
        ("/tracking_error/joint_states", ("position", "velocity")),
        ("/tracking_error/limbs", ("position", "velocity")),
    ],
)
def test_a_schema_has_the_fields_that_the_messages_have(topic, fields):
    """PlotJuggler draws the others as zeros."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(CHANNELS[topic].build_schema()).file:
        pool.Add(file)
    kind = GetMessageClass(pool.FindMessageTypeByName("foxglove.JointStates"))
    times, values = np.array([5_000_000_007]), np.arange(2.0 * len(fields)).reshape(-1, 1, 2)
    (data,) = JointStatesTemplate(("knee", "elbow"), fields).encode(times, *values)
    message = kind.FromString(data.tobytes())
    assert (message.timestamp.seconds, message.timestamp.nanos) == (5, 7)
    for i, joint in enumerate(message.joints):
        names = [one.name for one in joint.DESCRIPTOR.fields]
        assert names == ["name", *fields]
        assert [getattr(joint, name) for name in fields] == values[:, 0, i].tolist()
        assert all(joint.HasField(name) for name in fields)


# --- metadata survives the map of strings ---

numbers = st.integers() | st.floats(allow_nan=False)
scalars = st.none() | st.booleans() | numbers | st.text()
values = st.recursive(scalars, lambda v: st.lists(v) | st.dictionaries(st.text(), v), max_leaves=9)


@settings(max_examples=20)
@given(st.dictionaries(st.text(), values))
@example({"version": "0.10", "flag": "true", "quoted": '"x"', "nothing": "null", "empty": ""})
def test_any_json_comes_back_as_it_was(data):
    strings = metadata_to_strings(data)
    assert all(isinstance(string, str) for string in strings.values())
    back = metadata_from_strings(strings)
    assert back == data
    assert {k: type(v) for k, v in back.items()} == {k: type(v) for k, v in data.items()}


def test_numpy_becomes_numbers_and_lists():
    strings = metadata_to_strings({"kp": np.array([[1.5], [2.0]]), "n": {"at": np.int64(2**60)}})
    assert metadata_from_strings(strings) == {"kp": [[1.5], [2.0]], "n": {"at": 2**60}}
