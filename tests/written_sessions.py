"""Session files made of samples whose figures are known."""

from io import BytesIO

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory

from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.format import CHANNELS, encode_log
from g1stream.session.writer import SessionWriter


def decoded(topic, data):
    """A message of a channel in CDR, by another's decoder from the channel's own schema."""
    channel = CHANNELS[topic]
    schema = Schema(1, channel.build_schema(), channel.schema_encoding, channel.schema_name)
    return Ros2DecoderFactory().decoder_for(channel.message_encoding, schema)(bytes(data))


T0 = 1_700_000_000_000_000_000
STEP = 70_000_000
DELAY = 123_456


@pytest.fixture
def write_session(tmp_path):
    """Writes (topic, samples) with the times T0 + i * STEP, received DELAY later."""

    def write(*streams, name="session.mcap", close=True):
        path = tmp_path / name
        writer = SessionWriter(path)
        writer.add_metadata({"domain": 1, "versions": {"g1stream": "0.1.0"}, "at_end": False})
        writer.attach("motion.csv", "text/csv", b"Frame,X\n", T0)
        for i in range(max(len(samples) for _, samples in streams)):
            stamp = T0 + i * STEP
            for topic, samples in streams:
                if i < len(samples):
                    writer.write(topic, samples[i], stamp + DELAY, stamp)
        writer.write("/log", encode_log(T0, 3, "stream", "late by 3 ms"), T0 + 5, T0)
        if close:
            writer.add_metadata({"at_end": True})
            writer.close()
        else:
            writer.flush_if_due(T0 + 10**12)
        return path

    return write


def stock_reader(path, **options):
    """The stock reader of a file, which need not stay open."""
    return make_reader(BytesIO(path.read_bytes()), **options)


def wave(i):
    """(29,) rad, the pose of the i-th message of a recording."""
    return 0.3 * np.sin(2 * np.pi * i / 130 + np.arange(29) / 5)


def turned(n):
    """(n, 4) wxyz, the attitudes of the pelvis in it."""
    angles = 0.002 * np.arange(n)
    return np.stack([np.cos(angles), 0 * angles, 0 * angles, np.sin(angles)], axis=1)


@pytest.fixture
def record(tmp_path):
    """Joint states by Foxglove's classes at these times, and the pelvis with them.

    `angles` has the pose of each index; `parts` the joints of the messages at each time.
    """

    def make(times, *, angles=wave, parts=(range(29),), prefix="", norm=1.0):
        path = tmp_path / "take.mcap"
        with path.open("wb") as file, ProtobufWriter(file) as writer:
            for i, time in enumerate(times.tolist()):
                for n, part in enumerate(parts):
                    stamp, message = time + n * 3_000_000, JointStates()
                    message.timestamp.FromNanoseconds(stamp)
                    for joint in part:
                        name, angle = prefix + JOINT_NAMES[joint], float(angles(i)[joint])
                        message.joints.add(name=name, position=angle)
                    writer.write_message("/joints", message, stamp + 7, stamp)
                tf = FrameTransforms()
                pose = tf.transforms.add(parent_frame_id="world", child_frame_id=prefix + "pelvis")
                pose.timestamp.FromNanoseconds(time)
                pose.translation.z = 0.75 + 0.0005 * i
                pose.rotation.w, pose.rotation.z = (
                    norm * np.cos(0.002 * i),
                    norm * np.sin(0.002 * i),
                )
                writer.write_message("/frames", tf, time + 7, time)
        return path

    return make
