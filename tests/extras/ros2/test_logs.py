"""Bags of a robot's own topics, and of joint states, as sessions; written by rosbags."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import g1stream
from g1stream.dds.messages import LOWCMD, LOWSTATE, encode_samples
from g1stream.errors import RecordingError
from g1stream.session.format import CHANNELS

T0 = 1_700_000_000_000_000_000
TIME = np.arange(0.0, 14.0, 0.01)
STAMPS = T0 + np.round(TIME * 1e9).astype(np.int64)


@pytest.fixture(scope="module")
def samples():
    """The bundled motion, begun 3 s after the first message, with commands and states."""
    trajectory = g1stream.Trajectory(g1stream.load_motion("demo"))
    q = trajectory.sample_joints(TIME - 3.0)[0]
    command = {"motor_cmd.q": q, "motor_cmd.kp": np.full(q.shape, 50.0)}
    return {
        "lowcmd": encode_samples(LOWCMD, command, len(q)),
        "lowstate": encode_samples(LOWSTATE, {"motor_state.q": q}, len(q)),
    }


def write_bag(path, samples, storage, prefix="/"):
    """Raw samples under their ROS 2 types, whose definitions are those of our session files."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=9, storage_plugin=storage) as writer:
        for name, rows in samples.items():
            channel = CHANNELS[f"/{name}"]
            store.register(get_types_from_msg(channel.build_schema().decode(), channel.schema_name))
            connection = writer.add_connection(
                f"{prefix}{name}", channel.schema_name, typestore=store
            )
            for stamp, row in zip(STAMPS.tolist(), rows, strict=True):
                writer.write(connection, stamp, row.tobytes())
    return path


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("prefix", ["/", "/rt/", "rt/"])
def test_a_bag_of_the_robots_own_topics(tmp_path, samples, storage, prefix):
    bag = write_bag(tmp_path / "bag", samples, storage, prefix)
    session = g1stream.open_session(bag)
    assert session.topics == {"/lowcmd": len(TIME), "/lowstate": len(TIME)}
    assert [*session.replay_bytes("/lowstate")] == [row.tobytes() for row in samples["lowstate"]]
    np.testing.assert_array_equal(session.command.publish_time, STAMPS)
    attached = session.attach(g1stream.load_motion("demo"))
    assert attached.start_ns == pytest.approx(T0 + 3_000_000_000, abs=1_000_000)
    assert attached.tracking().overall < 1e-3


def test_joint_states_of_ros(tmp_path, samples):
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    q = g1stream.Samples(LOWSTATE, samples["lowstate"])["motor_state.q"]
    header, time = (
        store.types[f"{n}"] for n in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    nothing = np.zeros(0)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for stamp, row in zip(STAMPS.tolist(), q.astype(float), strict=True):
            head = header(time(*divmod(stamp, 10**9)), "")
            message = store.types[kind](head, list(g1stream.JOINT_NAMES), row, nothing, nothing)
            writer.write(connection, stamp + 5000, store.serialize_cdr(message, kind))
    session = g1stream.open_session(tmp_path / "bag")
    np.testing.assert_allclose(session.measured.q, q, atol=1e-6)
    np.testing.assert_array_equal(session.measured.publish_time, STAMPS)
    assert session.attach(g1stream.load_motion("demo")).attached.by_robot


def test_a_bag_of_something_else_is_refused(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/String"
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/chatter", kind, typestore=store)
        writer.write(connection, T0, store.serialize_cdr(store.types[kind]("hello"), kind))
    with pytest.raises(RecordingError, match="chatter"):
        g1stream.open_session(tmp_path / "bag")
