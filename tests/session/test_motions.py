"""Motions from motion files, and from sessions against the motion that was played in them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.app.session import open_session
from g1stream.dds.messages import Reference
from g1stream.errors import MotionError, RecordingError
from g1stream.motion.check import check_motion
from g1stream.motion.readers import find_motion, load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.session.writer import SessionWriter
from g1stream.types import Phase

T0 = 1_700_000_000_000_000_000
KNEE = JOINT_NAMES.index("left_knee_joint")
ROBOT = G1.default()


@pytest.fixture
def write(tmp_path):
    """A session in which a knee rises by 0.001 rad at each of 100 references of a phase."""

    def make(phase=Phase.PLAY, begin=0.3):
        path, message = tmp_path / "session.mcap", Reference()
        message.root_quat_wxyz[0] = 1.0
        message.phase[()] = phase
        with SessionWriter(path) as writer:
            for i in range(100):
                message.q[KNEE] = begin + 0.001 * i
                message.motion_time[()] = 0.002 * i
                stamp = T0 + 2_000_000 * i
                writer.write("/reference", message.tobytes(), stamp + 9, stamp)
        return path

    return make


def test_a_session_is_checked_as_the_motion_that_was_played(write):
    reader = find_motion(write()).open()
    evidence, report = reader.evidence, check_motion(reader.motion(), ROBOT)
    assert evidence.used["file"].startswith("a session")
    assert (report.n_frames, report.fps) == (100, 500.0)
    assert report.streamed.speeds[0].joint == "left_knee_joint"
    assert report.streamed.speeds[0].value == pytest.approx(0.5)
    assert report.passed


def test_a_session_beyond_a_limit_fails(write):
    report = check_motion(load_motion(write(begin=ROBOT.upper[KNEE])), ROBOT)
    assert report.frames_beyond[0].count == 99
    assert not report.passed


def test_the_frame_rate_is_as_given(write):
    assert load_motion(write(), fps=100.0).fps == 100.0


def test_a_session_in_which_nothing_was_played_is_an_error(write):
    with pytest.raises(RecordingError, match="No motion was played"):
        load_motion(write(Phase.RAMP))


def test_a_path_that_is_neither(tmp_path):
    with pytest.raises(MotionError, match=r"nowhere\.mcap"):
        load_motion(tmp_path / "nowhere.mcap")


# --- the motion that was played ---


def angle_between(quat, other):
    """rad, by scipy."""
    turns = (Rotation.from_quat(q.reshape(-1, 4), scalar_first=True) for q in (quat, other))
    return (next(turns).inv() * next(turns)).magnitude()


@pytest.fixture(scope="module")
def demo():
    return Trajectory(load_motion("demo"))


@pytest.fixture
def write_played(tmp_path, demo):
    """Writes the references of PLAY at these motion times, and of RAMP and HOLD around them."""

    def write(times, name="session.mcap"):
        before, after = np.full(50, times[0]), np.full(50, times[-1])
        phases = [Phase.RAMP] * 50 + [Phase.PLAY] * len(times) + [Phase.HOLD] * 50
        path, message = tmp_path / name, Reference()
        with SessionWriter(path) as writer:
            for i, (time, phase) in enumerate(
                zip(np.concatenate([before, times, after]), phases, strict=True)
            ):
                point = demo.sample(time)
                message.motion_time[()] = time
                message.phase[()] = phase
                message.q[:] = point.joint_pos
                message.root_pos[:] = point.root_pos
                message.root_quat_wxyz[:] = point.root_quat_wxyz
                stamp = T0 + i * 2_000_000
                writer.write("/reference", message.tobytes(), stamp + 9, stamp)
        return path

    return write


def test_at_its_own_rate_the_frames_are_the_references(write_played, demo):
    times = 1.0 + np.arange(1000) * 0.002
    motion = open_session(write_played(times)).motion()
    assert motion.fps == 500
    assert motion.n_frames == 1000
    expected = demo.sample_many(times)
    np.testing.assert_allclose(motion.joint_pos, expected.joint_pos, atol=1e-12)
    np.testing.assert_allclose(motion.root_pos, expected.root_pos, atol=1e-12)
    assert angle_between(motion.root_quat_wxyz, expected.root_quat_wxyz).max() < 1e-7


def test_ticks_that_were_skipped_are_filled_in(write_played, demo):
    times = 1.0 + np.arange(1000) * 0.002
    gone = np.r_[100:130, 400, 700:705]
    motion = open_session(write_played(np.delete(times, gone))).motion()
    assert motion.n_frames == 1000
    expected = demo.sample_many(times)
    np.testing.assert_allclose(motion.joint_pos, expected.joint_pos, atol=1e-3)
    np.testing.assert_allclose(motion.joint_pos[200:400], expected.joint_pos[200:400], atol=1e-6)


def test_at_the_rate_of_the_source_it_is_the_source(write_played):
    source = load_motion("demo")
    times = np.arange(round(2.0 * 500) + 1) * 0.002
    motion = open_session(write_played(times)).motion(fps=30)
    assert motion.fps == 30
    assert motion.n_frames == 61
    np.testing.assert_allclose(motion.joint_pos, source.joint_pos[:61], atol=1e-6)
    np.testing.assert_allclose(motion.root_pos, source.root_pos[:61], atol=1e-6)
    assert angle_between(motion.root_quat_wxyz, source.root_quat_wxyz[:61]).max() < 1e-4


def test_a_session_is_a_motion_file(write_played):
    path = write_played(np.arange(500) * 0.002, name="dance.mcap")
    motion = load_motion(path)
    assert motion.name == "dance"
    assert motion.source == path
    np.testing.assert_array_equal(motion.joint_pos, open_session(path).motion().joint_pos)
    assert load_motion(path, fps=100).n_frames == 100


def test_frame_rates_that_give_no_motion(write_played):
    session = open_session(write_played(np.arange(20) * 0.002))
    with pytest.raises(MotionError, match=r"0.* frames per second"):
        session.motion(fps=0)
    with pytest.raises(MotionError, match="1 frame"):
        session.motion(fps=1)
