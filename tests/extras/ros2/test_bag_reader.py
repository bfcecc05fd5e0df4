"""Motions and sessions in bags of others: written by rosbags, mcap and Foxglove's own classes."""

import sqlite3

import numpy as np
import pytest
import zstandard
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from mcap_protobuf.writer import Writer as ProtobufWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import g1stream
from g1stream.cli.main import main
from g1stream.dds.messages import LOWCMD, LOWSTATE, encode_samples
from g1stream.errors import MotionError, RecordingError
from g1stream.extras.ros2.bag_reader import DECODERS, open_bag
from g1stream.motion.readers import MotionFile, find_motion, load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.session.format import CHANNELS

ROS = get_typestore(Stores.ROS2_HUMBLE)
START = 1_700_000_000_000_000_000
STEP = 20_000_000  # 50 a second


def of_ros(name):
    return ROS.types[name]


def stamp(time_ns):
    return of_ros("builtin_interfaces/msg/Time")(*divmod(time_ns, 10**9))


def joint_state(time_ns, names, position):
    header = of_ros("std_msgs/msg/Header")(stamp(time_ns), "")
    nothing = np.zeros(0)
    kind = of_ros("sensor_msgs/msg/JointState")
    return kind(header, list(names), np.asarray(position, float), nothing, nothing)


def tf(time_ns, parent, child, pos, wxyz):
    geometry = {n: of_ros(f"geometry_msgs/msg/{n}") for n in ("Vector3", "Quaternion", "Transform")}
    w, x, y, z = wxyz
    pose = geometry["Transform"](geometry["Vector3"](*pos), geometry["Quaternion"](x, y, z, w))
    header = of_ros("std_msgs/msg/Header")(stamp(time_ns), parent)
    one = of_ros("geometry_msgs/msg/TransformStamped")(header, child, pose)
    return of_ros("tf2_msgs/msg/TFMessage")([one])


def write_bag(path, topics, storage=StoragePlugin.SQLITE3, compression=CompressionMode.NONE):
    """A bag by rosbags: topic -> (type, [(log time, message or its bytes)])."""
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        for topic, (kind, messages) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=ROS)
            for time_ns, message in messages:
                raw = isinstance(message, bytes)
                data = message if raw else ROS.serialize_cdr(message, kind)
                writer.write(connection, time_ns, data)
    return path


@pytest.fixture(scope="module")
def motion():
    """A second of the bundled motion at 50 fps, with the pelvis on its way and turning."""
    demo = load_motion("demo").frames(60, 110)
    t = np.arange(50) / 50.0
    quat = np.stack([np.cos(0.3 * t), 0.05 * np.sin(t), 0 * t, np.sin(0.3 * t)], axis=1)
    return g1stream.Motion.from_arrays(
        demo.joint_pos, demo.root_pos + t[:, None] * [0.1, 0.2, 0.0], quat, fps=50, name="part"
    )


@pytest.fixture(scope="module")
def joints(motion):
    """Its joint states, in another order and with fingers, half a millisecond after the log."""
    names = [*reversed(motion.joint_names), "left_thumb_joint"]
    return [
        (START + i * STEP, joint_state(START + i * STEP - 500_000, names, [*row[::-1], 0.3]))
        for i, row in enumerate(motion.joint_pos)
    ]


@pytest.fixture(scope="module")
def transforms(motion):
    """The pelvis in the frame of odometry, and another frame."""
    rows = zip(motion.root_pos, motion.root_quat_wxyz, strict=True)
    found = []
    for i, (pos, quat) in enumerate(rows):
        time_ns = START + i * STEP - 500_000
        found.append((time_ns, tf(time_ns, "odom", "pelvis", pos, quat)))
        found.append((time_ns, tf(time_ns, "pelvis", "imu", [0, 0, 1], [1, 0, 0, 0])))
    return found


JOINT_STATE, TF = "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage"


@pytest.mark.parametrize("storage", StoragePlugin)
def test_a_bag_of_ros(tmp_path, motion, joints, transforms, storage):
    topics = {"/joint_states": (JOINT_STATE, joints), "/tf": (TF, transforms)}
    directory = write_bag(tmp_path / "bag", topics, storage)
    (file,) = [one for one in directory.iterdir() if one.name != "metadata.yaml"]
    for path in (directory, file):
        found = load_motion(path)
        assert found.fps == 50.0
        np.testing.assert_array_equal(found.joint_pos, motion.joint_pos)
        np.testing.assert_array_equal(found.root_pos, motion.root_pos)
        np.testing.assert_allclose(found.root_quat_wxyz, motion.root_quat_wxyz, atol=1e-15)
    evidence = find_motion(directory).open().evidence
    assert "/joint_states" in evidence.used["file"]
    assert "pelvis in odom" in evidence.used["pelvis"]


@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
    ],
)
def test_a_compressed_bag(tmp_path, motion, joints, storage, compression):
    topics = {"/joint_states": (JOINT_STATE, joints)}
    bag = write_bag(tmp_path / "bag", topics, storage, compression)
    (file,) = (one for one in bag.iterdir() if one.suffix != ".yaml")
    for path in (bag, file):
        if path == bag or compression != CompressionMode.FILE:
            np.testing.assert_array_equal(load_motion(path).joint_pos, motion.joint_pos)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_samples_that_are_compressed_one_by_one(tmp_path, played, storage):
    """`compression_mode: message`; read also without the metadata.yaml that says so."""
    q, stamps = (values[:200] for values in played)
    rows = [row.tobytes() for row in encode_samples(LOWSTATE, {"motor_state.q": q}, len(q))]
    channel = CHANNELS["/lowstate"]
    ROS.register(get_types_from_msg(channel.build_schema().decode(), channel.schema_name))
    topics = {"/lowstate": (channel.schema_name, zip(stamps.tolist(), rows, strict=True))}
    bag = write_bag(tmp_path / "bag", topics, storage, CompressionMode.MESSAGE)
    (file,) = (one for one in bag.iterdir() if one.suffix != ".yaml")
    for path in (bag, file):
        with pytest.raises(RecordingError) as refused:
            load_motion(path)
        assert "g1stream attach" in refused.value.remedy
        session = g1stream.open_session(path)
        assert [*session.replay_bytes("/lowstate")] == rows
        np.testing.assert_array_equal(session.measured.q, np.float32(q))


@pytest.mark.parametrize("content", ["cut", "no size", "huge"])
def test_compressed_messages_that_are_damaged_or_too_large(tmp_path, joints, content):
    message = ROS.serialize_cdr(joints[0][1], JOINT_STATE)
    data = bytearray(zstandard.compress(message))
    if content == "cut":
        data = data[:-20]
    elif content == "no size":
        stream = zstandard.ZstdCompressor(write_content_size=False).compressobj()
        data = stream.compress(message) + stream.flush()
    else:  # a frame that says 1 TiB
        data = b"\x28\xb5\x2f\xfd\xe0" + (2**40).to_bytes(8, "little") + bytes(data[6:])
    topics = {"/joint_states": (JOINT_STATE, [(START + i * STEP, bytes(data)) for i in range(9)])}
    for storage in (StoragePlugin.SQLITE3, StoragePlugin.MCAP):
        with pytest.raises(RecordingError):
            load_motion(write_bag(tmp_path / storage.name, topics, storage))


def test_a_file_without_its_end_is_read_to_the_cut(tmp_path, motion, joints):
    """As the recorder leaves it that was killed."""
    directory = write_bag(
        tmp_path / "bag", {"/joint_states": (JOINT_STATE, 40 * joints)}, StoragePlugin.MCAP
    )
    (path,) = directory.glob("*.mcap")
    path.write_bytes(path.read_bytes()[:1_500_000])
    found = open_bag(MotionFile(path))
    assert 500 < int(found.evidence.used["file"].split()[1].replace(",", "")) < 2000


def test_without_transforms_the_pelvis_is_upright(tmp_path, joints):
    found = load_motion(write_bag(tmp_path / "bag", {"/joint_states": (JOINT_STATE, joints)}))
    assert not found.root_pos.any()
    assert (found.root_quat_wxyz == [1, 0, 0, 0]).all()


def test_stamps_that_do_not_rise_are_not_taken(tmp_path, motion, joints):
    unstamped = [(t, joint_state(0, m.name, m.position)) for t, m in joints]
    found = load_motion(write_bag(tmp_path / "bag", {"/js": (JOINT_STATE, unstamped)}))
    assert found.fps == 50.0
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos)


def test_times_of_both_topics_are_of_one_clock(tmp_path, motion, joints, transforms):
    """Unstamped transforms, and unstamped joints with transforms in the time of a simulation."""
    poses = list(zip(motion.root_pos, motion.root_quat_wxyz, strict=True))

    def moved(stamp_of, published=START):
        return [
            (published + i * STEP, tf(stamp_of(i), "odom", "pelvis", *pose))
            for i, pose in enumerate(poses)
        ]

    bare = [(t, joint_state(0, m.name, m.position)) for t, m in joints]
    cases = {
        "transforms": (joints, moved(lambda i: 0)),
        "joints": (bare, moved(lambda i: i * STEP)),
        "clocks": (joints, moved(lambda i: i * STEP)),
    }
    for name, (states, frames) in cases.items():
        topics = {"/joint_states": (JOINT_STATE, states), "/tf": (TF, frames)}
        found = load_motion(write_bag(tmp_path / name, topics))
        np.testing.assert_array_equal(found.root_pos, motion.root_pos)
    other = moved(lambda i: i * STEP, START + 10**12)
    topics = {"/joint_states": (JOINT_STATE, joints), "/tf": (TF, other)}
    with pytest.raises(RecordingError, match="another time"):
        load_motion(write_bag(tmp_path / "other", topics))


def test_transforms_that_no_pelvis_has(tmp_path, joints):
    for name, quat in {"zero": [0, 0, 0, 0], "nan": [np.nan, 0, 0, 1]}.items():
        frames = [(t, tf(t, "odom", "pelvis", [0, 0, 1], quat)) for t, _ in joints[::3]]
        topics = {"/joint_states": (JOINT_STATE, joints), "/tf": (TF, frames)}
        with pytest.raises(RecordingError, match="quaternion"):
            load_motion(write_bag(tmp_path / name, topics))


@pytest.mark.parametrize(
    "change",
    [
        "CREATE TABLE t AS SELECT id, topic_id, timestamp, NULL AS data FROM messages; "
        "DROP TABLE messages; ALTER TABLE t RENAME TO messages",
        "UPDATE messages SET data = 7 WHERE id = 3",
        "UPDATE messages SET timestamp = -9223372036854775808 WHERE id = 3",
        "CREATE TABLE t AS SELECT NULL AS id, name, type, serialization_format FROM topics; "
        "DROP TABLE topics; ALTER TABLE t RENAME TO topics",
    ],
)
def test_values_that_no_bag_has(tmp_path, joints, change):
    directory = write_bag(tmp_path / "bag", {"/joint_states": (JOINT_STATE, joints)})
    (path,) = directory.glob("*.db3")
    with sqlite3.connect(path) as database:
        database.executescript(change)
    database.close()
    with pytest.raises(RecordingError, match="cannot be read as a bag of ROS 2"):
        load_motion(path)


def test_a_bag_of_the_robot_with_joint_states_is_no_session(tmp_path, motion, joints):
    text = [(START, of_ros("std_msgs/msg/String")("hello"))]
    topics = {"/lowstate": ("std_msgs/msg/String", text), "/joint_states": (JOINT_STATE, joints)}
    found = load_motion(write_bag(tmp_path / "bag", topics, StoragePlugin.MCAP))
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos)


def test_joint_states_of_foxglove(tmp_path, motion):
    path = tmp_path / "robot.mcap"
    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for i, row in enumerate(motion.joint_pos):
            message = JointStates()
            message.timestamp.FromNanoseconds(START + i * STEP)
            for name, angle in zip(motion.joint_names, row.tolist(), strict=True):
                message.joints.add(name=name, position=angle)
            writer.write_message("/robot/joints", message, START + i * STEP, START + i * STEP)
    np.testing.assert_array_equal(load_motion(path).joint_pos, motion.joint_pos)
    assert load_motion(path, fps=25).n_frames == 25


@pytest.mark.parametrize("out", ["a.csv", "a.npz", "a.mcap", "bag"])
def test_convert_and_back(tmp_path, motion, out):
    """A motion comes back to the last bit."""
    source, path = motion.save(tmp_path / "part.npz"), tmp_path / out
    if out == "bag":
        assert main(["convert", str(source), str(tmp_path / "a.mcap")]) == 0
        source = tmp_path / "a.mcap"
    assert main(["convert", str(source), str(path), *(["--ros2"] if out == "bag" else [])]) == 0
    found = load_motion(path, fps=50 if out == "a.csv" else None)
    assert found.fps == motion.fps
    np.testing.assert_array_equal(found.joint_pos, motion.joint_pos)
    np.testing.assert_array_equal(found.root_pos, motion.root_pos)
    np.testing.assert_array_equal(found.root_quat_wxyz, motion.root_quat_wxyz)


STRING = "std_msgs/msg/String"


def test_what_is_no_motion_of_a_g1(tmp_path, joints):
    text = [(START, of_ros(STRING)("hello"))]
    upper = [(t, joint_state(t, m.name[15:29], m.position[15:29])) for t, m in joints]
    cases = [
        ({"/lowstate": (STRING, text)}, RecordingError, "only std_msgs/msg/String"),
        (dict.fromkeys(("/a/js", "/b/js"), (JOINT_STATE, joints)), RecordingError, "/a/js, /b/js"),
        ({"/js": (JOINT_STATE, upper)}, MotionError, "lacks the joints waist_pitch_joint"),
    ]
    for i, (topics, error, named) in enumerate(cases):
        with pytest.raises(error, match=named):
            load_motion(write_bag(tmp_path / str(i), topics))


def test_messages_that_are_not_what_they_say(tmp_path, joints):
    (time_ns, message), path = joints[0], tmp_path / "bag"
    whole = bytes(ROS.serialize_cdr(message, JOINT_STATE))
    decode = DECODERS.joint_states[JOINT_STATE, "cdr"]
    assert decode(whole).names == tuple(message.name)
    with pytest.raises(ValueError, match=r".+"):
        decode(whole[:-1])
    write_bag(path, {"/joint_states": (JOINT_STATE, [(time_ns, whole[:100])])})
    with pytest.raises(RecordingError, match="is not a sensor_msgs/msg/JointState"):
        load_motion(path)


@pytest.fixture(scope="module")
def played():
    """Joint positions of the bundled motion, begun 3 s after the first message, and times, ns."""
    time = np.arange(0.0, 14.0, 0.01)
    q = Trajectory(load_motion("demo")).sample_joints(time - 3.0)[0]
    return q, START + np.round(time * 1e9).astype(np.int64)


@pytest.mark.parametrize(
    ("storage", "prefix"),
    [(StoragePlugin.SQLITE3, "/"), (StoragePlugin.MCAP, "/rt/"), (StoragePlugin.SQLITE3, "rt/")],
)
def test_a_bag_of_the_robots_own_topics(tmp_path, played, storage, prefix):
    """Raw samples under their ROS 2 types, whose definitions are those of our session files."""
    q, stamps = (values[:200] for values in played)
    command = {"motor_cmd.q": q, "motor_cmd.kp": np.full(q.shape, 50.0)}
    samples = {
        "lowcmd": encode_samples(LOWCMD, command, len(q)),
        "lowstate": encode_samples(LOWSTATE, {"motor_state.q": q}, len(q)),
    }
    topics = {}
    for name, rows in samples.items():
        channel = CHANNELS[f"/{name}"]
        ROS.register(get_types_from_msg(channel.build_schema().decode(), channel.schema_name))
        data = [row.tobytes() for row in rows]
        topics[f"{prefix}{name}"] = channel.schema_name, zip(stamps.tolist(), data, strict=True)
    session = g1stream.open_session(write_bag(tmp_path / "bag", topics, storage))
    assert session.topics == {"/lowcmd": 200, "/lowstate": 200}
    assert [*session.replay_bytes("/lowstate")] == data
    np.testing.assert_array_equal(session.command.publish_time, stamps)
    np.testing.assert_array_equal(session.command.q, np.float32(q))


def test_joint_states_are_a_session(tmp_path, played):
    q, stamps = played
    states = [
        (stamp + 5000, joint_state(stamp, g1stream.JOINT_NAMES, row))
        for stamp, row in zip(stamps.tolist(), q, strict=True)
    ]
    bag = write_bag(tmp_path / "bag", {"/joint_states": (JOINT_STATE, states)})
    session = g1stream.open_session(bag)
    np.testing.assert_allclose(session.measured.q, q, atol=1e-6)
    np.testing.assert_array_equal(session.measured.publish_time, stamps)
    attached = session.attach(load_motion("demo"))
    assert attached.attached.by_robot
    assert attached.start_ns == pytest.approx(START + 3_000_000_000, abs=1_000_000)


def test_a_bag_of_something_else_is_no_session(tmp_path):
    bag = write_bag(tmp_path / "bag", {"/chatter": (STRING, [(START, of_ros(STRING)("hello"))])})
    with pytest.raises(RecordingError, match="chatter"):
        g1stream.open_session(bag)
