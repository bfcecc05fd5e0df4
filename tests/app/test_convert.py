"""Converted files, decoded with other people's packages and compared with yourdfpy's kinematics."""

import subprocess
import sys
from collections import defaultdict
from io import StringIO

import numpy as np
import pytest
import yourdfpy
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros2.decoder import DecoderFactory as Ros2Decoders
from scipy.spatial.transform import Rotation

from g1stream.app.convert import convert
from g1stream.errors import ConfigError, MotionError
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.session.format import metadata_from_strings
from written_sessions import stock_reader

T0 = 1_700_000_000_000_000_000
JOINTS = "/reference/joint_states"


@pytest.fixture(scope="module")
def motion():
    """150 frames, more than a chunk; joints anywhere within their limits, the root anywhere."""
    robot, rng = G1.default(), np.random.default_rng(9)
    return Motion(
        name="anywhere",
        fps=30.0,
        joint_pos=rng.uniform(robot.lower, robot.upper, (150, 29)),
        root_pos=rng.normal(size=(150, 3)),
        root_quat_wxyz=rng.normal(size=(150, 4)),
    )


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out.mcap"


def read(path):
    """Messages by topic, each with its decoded body."""
    found = defaultdict(list)
    with path.open("rb") as file:
        factories = [ProtobufDecoders(), Ros2Decoders()]
        reader = make_reader(file, validate_crcs=True, decoder_factories=factories)
        for _, channel, message, body in reader.iter_decoded_messages():
            found[channel.topic].append((message, body))
    return found


def world_poses(body):
    """Each link's matrix, by following the frames from the world as a viewer does."""
    found = {"world": np.eye(4)}
    for t in body.transforms:
        p, q = t.translation, t.rotation
        local = np.eye(4)
        local[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        local[:3, 3] = p.x, p.y, p.z
        found[t.child_frame_id] = found[t.parent_frame_id] @ local
    return found


def root_matrix(motion, frame):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(np.roll(motion.root_quat_wxyz[frame], -1)).as_matrix()
    matrix[:3, 3] = motion.root_pos[frame]
    return matrix


@pytest.fixture(scope="module")
def urdf():
    return yourdfpy.URDF.load(StringIO(G1.default().urdf), load_meshes=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{}, {"flat": True}, {"floating_root": False}],
    ids=str,
)
def test_link_poses_match_yourdfpy(motion, urdf, out, options):
    report = convert(motion, out, **options)
    messages = read(out)
    assert {topic: len(found) for topic, found in messages.items()} == report.counts
    assert report.counts == {"/tf": 150, JOINTS: 150, "/scene": 1, "/robot_description": 1}
    floats = options.get("floating_root", True)
    for frame in (0, 127, 128, 149):
        body = messages["/tf"][frame][1]
        assert body.transforms[0].child_frame_id == "pelvis"
        parents = {one.parent_frame_id for one in body.transforms}
        assert (parents == {"world"}) == ("flat" in options)
        urdf.update_cfg(dict(zip(JOINT_NAMES, motion.joint_pos[frame], strict=True)))
        root = root_matrix(motion, frame) if floats else np.eye(4)
        expected = {link: root @ urdf.get_transform(link, "pelvis") for link in urdf.link_map}
        poses = world_poses(body)
        assert poses.keys() == {"world", *expected}
        for link, matrix in expected.items():
            np.testing.assert_allclose(poses[link], matrix, atol=1e-9)


def stamps_of(body):
    """The stamps inside a message."""
    inside = getattr(body, "transforms", None) or getattr(body, "entities", None) or [body]
    return {item.timestamp.ToNanoseconds() for item in inside}


@pytest.mark.parametrize(("how", "rate"), [({}, 30), ({"fps": 15.0}, 15), ({"resample": 90.0}, 90)])
def test_log_time_publish_time_and_timestamps_inside_are_equal(motion, out, how, rate):
    resample = how.get("resample")
    convert(motion, out, base_time_ns=T0, resample=resample, fps=how.get("fps"))
    messages = read(out)
    for topic in ("/tf", JOINTS):
        for frame, (message, body) in enumerate(messages[topic]):
            exact = T0 + (2 * frame * 10**9 + rate) // (2 * rate)
            assert message.log_time == message.publish_time == exact
            assert message.sequence == frame + 1
            assert stamps_of(body) == {exact}
    for topic in ("/scene", "/robot_description"):
        ((message, _),) = messages[topic]
        assert message.log_time == message.publish_time == T0
    ((_, scene),) = messages["/scene"]
    assert stamps_of(scene) == {T0}


def test_a_frame_range_has_the_messages_of_the_whole(motion, out, tmp_path):
    convert(motion, out)
    whole, part = read(out), tmp_path / "part.mcap"
    for frames, kept in (((10, 140), range(10, 140)), ((145, None), range(145, 150))):
        convert(motion, part, frames=frames, force=True)
        cut = read(part)
        for topic in ("/tf", JOINTS):
            due = [whole[topic][i][0] for i in kept]
            assert [m.data for m, _ in cut[topic]] == [message.data for message in due]
            assert [m.log_time for m, _ in cut[topic]] == [message.log_time for message in due]


def test_resampled_joints_go_through_the_frames_and_have_velocities(motion, out):
    report = convert(motion, out, resample=90.0)
    assert report.rate == 90.0
    bodies = [body for _, body in read(out)[JOINTS]]
    assert len(bodies) == 149 * 3 + 1
    position = np.array([[joint.position for joint in body.joints] for body in bodies])
    velocity = np.array([[joint.velocity for joint in body.joints] for body in bodies])
    np.testing.assert_allclose(position[::3], motion.joint_pos, atol=1e-9)
    # Simpson's rule is exact on cubics, up to where they are joined: over two samples of three.
    moved = (velocity[:-2] + 4 * velocity[1:-1] + velocity[2:]) / (6 * 45.0)
    inside = np.arange(len(moved)) % 3 < 2
    np.testing.assert_allclose(moved[inside], (position[2:] - position[:-2])[inside], atol=1e-9)
    assert all(joint.HasField("acceleration") for joint in bodies[7].joints)


def test_the_transforms_alone(motion, out, tmp_path):
    """As the tutorial of Foxglove makes them: one topic, and nothing attached."""
    report = convert(motion, out, only_tf=True)
    assert (report.counts, report.frames) == ({"/tf": 150}, 150)
    whole = tmp_path / "whole.mcap"
    convert(motion, whole)
    alone, all_of_it = read(out), read(whole)
    assert {*alone} == {"/tf"}
    assert [m.data for m, _ in alone["/tf"]] == [m.data for m, _ in all_of_it["/tf"]]
    assert not list(stock_reader(out).iter_attachments())


def test_urdf_and_motion_are_attached(out):
    motion = load_motion("demo")
    convert("demo", out)
    urdf = G1.default().urdf
    with out.open("rb") as file:
        reader = make_reader(file)
        attachments = {a.name: a.data for a in reader.iter_attachments()}
        (record,) = reader.iter_metadata()
    assert attachments == {"robot.urdf": urdf.encode(), "demo.csv": motion.source.read_bytes()}
    assert read(out)["/robot_description"][0][1].data == urdf
    values = metadata_from_strings(record.metadata)
    assert values["motion"]["sha256"] == motion.sha256
    assert values["conversion"]["base_time_ns"] == 0


def test_the_same_input_gives_the_same_bytes(out, tmp_path):
    again = tmp_path / "again.mcap"
    convert("demo", out)
    convert("demo", again)
    assert out.read_bytes() == again.read_bytes()


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"frames": (100, 50)}, MotionError, "100:50"),
        ({"frames": (0, 151)}, MotionError, "150"),
        ({"resample": float("nan")}, MotionError, "nan"),
        ({"frames": (0, 1), "resample": 100.0}, MotionError, "no sample"),
        ({"base_time_ns": 2**63 - 1}, ConfigError, "2116"),
    ],
)
def test_invalid_options_are_refused_and_leave_no_file(motion, out, options, error, message):
    with pytest.raises(error, match=message):
        convert(motion, out, **options)
    assert list(out.parent.iterdir()) == []


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(ConfigError):
        convert("demo", tmp_path / "clip.csv")
    assert not list(tmp_path.iterdir())


IMPORTS = """
import sys
from g1stream.cli.main import main
code = main(["convert", "demo", sys.argv[1]])
heavy = ("scipy", "trimesh", "yourdfpy", "mujoco", "cyclonedds", "matplotlib")
print(code, [name for name in heavy if name in sys.modules])
"""


def test_conversion_imports_nothing_that_it_does_not_need(out):
    command = [sys.executable, "-c", IMPORTS, str(out)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "0 []"
