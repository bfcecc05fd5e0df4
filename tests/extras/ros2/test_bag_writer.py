"""A session as a ROS 2 bag, read by two readers that know ROS's messages and nothing of ours."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.rosbag2 import Reader

from g1stream.app.session import open_session
from g1stream.cli.main import main
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE
from g1stream.errors import RecordingError
from g1stream.extras.ros2.bag_writer import write_ros2_bag
from g1stream.robot.model import G1
from g1stream.robot.urdf import with_prefixed_links
from g1stream.session.format import CHANNELS, encode_string
from g1stream.session.writer import SessionWriter
from g1stream.view.encoders import JointStatesTemplate, TransformsEncoder
from written_sessions import stock_reader

T0, STEP, DELAY = 1_700_000_000_000_000_000, 70_000_000, 123_456
N = 8
NAMES = ("left_knee_joint", "waist_yaw_joint")
Q = np.arange(2.0 * N).reshape(N, 2) / 7


@pytest.fixture
def samples(make_sample, on_the_wire):
    return {
        topic: [on_the_wire(make_sample(source)) for _ in range(N)]
        for topic, source in (
            ("/lowcmd", LOWCMD),
            ("/lowstate", LOWSTATE),
            ("/reference", REFERENCE),
        )
    }


TIMING = struct.pack("<4B2d", 0, 1, 0, 0, 2.5, 0.125)


@pytest.fixture
def recorded(write_session, samples):
    times = T0 + STEP * np.arange(N)
    joints = JointStatesTemplate(NAMES, ("position", "velocity", "effort")).encode(
        times, Q, 2 * Q, 3 * Q
    )
    error = JointStatesTemplate(NAMES, ("position", "velocity")).encode(times, Q, 2 * Q)
    robot = G1.default()
    pose = (
        np.zeros((N, 29)),
        np.tile([1.0, 2.0, 3.0], (N, 1)),
        np.tile([0.5, 0.5, 0.5, -0.5], (N, 1)),
    )
    derived = {
        "/measured/joint_states": joints,
        "/tracking_error/joint_states": error,
        "/tf": TransformsEncoder(robot).encode(times, *pose),
        "/measured/tf": TransformsEncoder(robot, "measured/").encode(times, *pose),
        "/timing/states": np.frombuffer(TIMING * N, np.uint8).reshape(N, -1),
    }
    streams = {topic: [row.tobytes() for row in rows] for topic, rows in derived.items()}
    shown = with_prefixed_links(robot.xml, "measured/")
    description = {"/measured/robot_description": [encode_string(shown)]}
    return write_session(*(samples | streams | description).items())


@pytest.fixture
def bag(recorded, tmp_path):
    return write_ros2_bag(recorded, tmp_path / "bag").path


def messages(bag):
    """By topic, the log time and the decoded value of each message, by rosbags."""
    with AnyReader([bag]) as reader:
        found = {}
        for connection, time, data in reader.messages():
            value = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, value))
    return found


def stamp(header):
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def test_joint_states_have_the_names_values_and_times_of_the_session(bag):
    found = messages(bag)
    for i, (time, value) in enumerate(found["/measured/joint_states"]):
        assert (time, stamp(value.header)) == (T0 + i * STEP + DELAY, T0 + i * STEP)
        assert tuple(value.name) == NAMES
        np.testing.assert_array_equal(value.position, Q[i])
        np.testing.assert_array_equal(value.velocity, 2 * Q[i])
        np.testing.assert_array_equal(value.effort, 3 * Q[i])
    error = found["/tracking_error/joint_states"][3][1]
    assert (error.position.tolist(), error.effort.tolist()) == (Q[3].tolist(), [])


def test_all_transforms_are_on_the_topic_that_ros_reads(bag):
    values = [value for _, value in messages(bag)["/tf"]]
    assert len(values) == 2 * N
    roots = {value.transforms[0].child_frame_id: value.transforms[0] for value in values}
    assert roots.keys() == {"pelvis", "measured/pelvis"}
    root = roots["measured/pelvis"]
    assert (root.header.frame_id, stamp(root.header)) == ("world", T0 + (N - 1) * STEP)
    t, q = root.transform.translation, root.transform.rotation
    assert (t.x, t.y, t.z, q.x, q.y, q.z, q.w) == (1.0, 2.0, 3.0, 0.5, 0.5, -0.5, 0.5)
    assert len(values[0].transforms) == len(G1.default().link_names)


def test_the_transforms_are_written_in_the_order_of_their_log_times(bag):
    """In a session they are on three topics, whose chunks follow one another."""
    in_file = stock_reader(bag / "bag_0.mcap").iter_messages(["/tf"], log_time_order=False)
    times = [message.log_time for _, _, message in in_file]
    assert len(times) == 2 * N
    assert times == sorted(times)


def test_timing_keeps_its_values(bag):
    found = [
        message.ros_msg
        for message in read_ros2_messages(bag / "bag_0.mcap", topics=["/timing/states"])
    ]
    assert [(one.interval_ms, one.latency_ms) for one in found] == [(2.5, 0.125)] * N


def test_messages_of_another_type_are_left_out(bag, tmp_path, samples):
    """Earlier versions wrote /timing/* in JSON, and a bag has its /tf in CDR."""
    path = tmp_path / "earlier.mcap"
    json_type = replace(
        CHANNELS["/timing/states"],
        schema_name="g1stream.Timing",
        schema_encoding="jsonschema",
        message_encoding="json",
    )
    with SessionWriter(path, channels=CHANNELS | {"/timing/states": json_type}) as writer:
        writer.write("/lowstate", samples["/lowstate"][0], T0, T0)
        writer.write("/timing/states", b'{"interval_ms": 2}', T0, T0)
    assert write_ros2_bag(path, tmp_path / "of_earlier").left_out == {"/timing/states": 1}
    for source, kept in ((path, set()), (bag, {"/timing/states"})):
        saved = open_session(open_session(source).save(tmp_path / "saved.mcap", force=True))
        assert kept | {"/lowstate"} <= saved.topics.keys()
        assert not ({"/tf", "/timing/states"} - kept) & saved.topics.keys()


def test_the_log_and_the_urdf(bag):
    found = messages(bag)
    ((time, line),) = found["/rosout"]
    assert (time, line.level, line.name, line.msg) == (T0 + 5, 30, "stream", "late by 3 ms")
    assert line.level == line.WARN
    urdf = found["/robot_description"][0][1].data
    assert G1.from_urdf(urdf, "the bag").link_names == G1.default().link_names


def test_samples_keep_their_bytes_and_both_times(bag, samples):
    session = open_session(bag)
    for topic, data in samples.items():
        found = list(session.messages(topic))
        assert [message.data for message in found] == data
        times = [(T0 + i * STEP + DELAY, T0 + i * STEP) for i in range(N)]
        assert [(message.log_time, message.publish_time) for message in found] == times
    assert session.metadata["at_end"] is True
    assert session.attachments == {"motion.csv": b"Frame,X\n"}


def test_unitrees_messages_are_decoded_by_both_readers(bag, recorded):
    q = open_session(recorded).measured.q
    by_rosbags = [value for _, value in messages(bag)["/lowstate"]]
    by_mcap = [
        message.ros_msg for message in read_ros2_messages(bag / "bag_0.mcap", topics=["/lowstate"])
    ]
    for values in (by_rosbags, by_mcap):
        found = [[motor.q for motor in value.motor_state[:29]] for value in values]
        np.testing.assert_array_equal(np.float32(found), np.float32(q))


def test_metadata_yaml_counts_what_is_in_the_bag(recorded, tmp_path):
    report = write_ros2_bag(recorded, tmp_path / "bag.mcap")
    assert report.path == tmp_path / "bag"
    assert report.left_out == {}
    with Reader(report.path) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == report.counts
        assert len(list(reader.messages())) == reader.message_count == sum(report.counts.values())
        assert reader.start_time == T0 + 5
        assert reader.end_time == T0 + (N - 1) * STEP + DELAY + 1


@pytest.mark.parametrize("name", ["", "bag_0.mcap"])
def test_a_player_offers_the_description_to_late_subscribers_and_nothing_else(bag, name):
    with Reader(bag / name) as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    (qos,) = offered.pop("/robot_description")
    assert (qos.durability, qos.reliability) == (
        QosDurability.TRANSIENT_LOCAL,
        QosReliability.RELIABLE,
    )
    assert (qos.history, qos.depth) == (QosHistory.KEEP_LAST, 1)
    assert qos.liveliness == QosLiveliness.AUTOMATIC
    assert {time.sec + time.nsec for time in (qos.deadline, qos.lifespan)} == {0}
    assert offered.keys() >= {"/tf", "/measured/joint_states", "/lowstate"}
    assert not any(offered.values())


def test_a_bag_is_replaced_only_when_forced_and_nothing_else_is(recorded, bag, tmp_path):
    with pytest.raises(RecordingError, match="exists already"):
        write_ros2_bag(recorded, bag)
    assert write_ros2_bag(recorded, bag, force=True).counts["/lowcmd"] == N
    for session, out in ((recorded, recorded.parent), (bag, bag)):
        with pytest.raises(RecordingError, match="contains the session"):
            write_ros2_bag(session, out, force=True)
    (bag / "notes.txt").touch()
    with pytest.raises(RecordingError, match=r"notes\.txt"):
        write_ros2_bag(recorded, bag, force=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "session.mcap"]


@pytest.mark.parametrize("topic", ["/tf", "/measured/robot_description"])
def test_what_cannot_be_decoded_leaves_nothing_behind(write_session, samples, tmp_path, topic):
    damaged = write_session(*samples.items(), (topic, [b"\xff"]), name="damaged.mcap")
    with pytest.raises(RecordingError, match=topic):
        write_ros2_bag(damaged, tmp_path / "bag")
    assert [path.name for path in tmp_path.iterdir()] == ["damaged.mcap"]


def test_the_command_and_the_flags_of_motions_that_it_refuses(tmp_path, capsys):
    session, bag = tmp_path / "out.mcap", tmp_path / "out"
    assert main(["convert", "demo", str(session)]) == 0
    assert main(["convert", str(session), str(bag), "--ros2", "--frames", "1:2"]) == 2
    assert main(["convert", "demo", str(bag), "--ros2"]) == 2
    assert not bag.exists()
    capsys.readouterr()
    assert main(["convert", str(session), "-o", str(bag), "--ros2", "--json", "-q"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["path"] == str(bag)
    assert report["counts"].keys() == {"/tf", "/reference/joint_states", "/robot_description"}
    assert report["left_out"] == {"/scene": 1}
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "out_0.mcap"]


def content(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def no_directory(path):
    path.rename(path.with_name("moved"))
    path.write_bytes(b"precious")


def link(path):
    path.rename(path.with_name("moved"))
    path.symlink_to("moved")


@pytest.mark.parametrize(
    "change",
    [
        lambda path: (path / "notes.txt").write_bytes(b"precious"),
        no_directory,
        link,
    ],
)
def test_only_a_bag_of_ours_is_replaced_and_only_with_force(recorded, tmp_path, change):
    out = tmp_path / "bag"
    write_ros2_bag(recorded, out)
    before = content(tmp_path)
    with pytest.raises(RecordingError):
        write_ros2_bag(recorded, out)
    assert content(tmp_path) == before
    assert write_ros2_bag(recorded, out, force=True).path == out
    change(out)
    before = content(tmp_path)
    for force in (True, False):
        with pytest.raises(RecordingError):
            write_ros2_bag(recorded, out, force=force)
    assert content(tmp_path) == before
