import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.app.session import open_session
from g1stream.dds.messages import Reference
from g1stream.errors import MotionError, RecordingError
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.session.writer import SessionWriter
from g1stream.types import Phase

T0 = 1_700_000_000_000_000_000


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

    def write(times, play=Phase.PLAY):
        phases = [Phase.RAMP] * 50 + [play] * len(times) + [Phase.HOLD] * 50
        path, message = tmp_path / "dance.mcap", Reference()
        points = demo.sample_many(np.pad(times, 50, mode="edge"))
        with SessionWriter(path) as writer:
            for i, phase in enumerate(phases):
                message.motion_time[()] = times[min(max(i - 50, 0), len(times) - 1)]
                message.phase[()] = phase
                message.q[:] = points.joint_pos[i]
                message.root_pos[:] = points.root_pos[i]
                message.root_quat_wxyz[:] = points.root_quat_wxyz[i]
                stamp = T0 + i * 2_000_000
                writer.write("/reference", message.tobytes(), stamp + 9, stamp)
        return path

    return write


def test_at_its_own_rate_the_frames_are_the_references(write_played, demo):
    times = 1.0 + np.arange(500) * 0.002
    path = write_played(times)
    motion, expected = load_motion(path), demo.sample_many(times)
    assert (motion.name, motion.source, motion.fps, motion.n_frames) == ("dance", path, 500, 500)
    np.testing.assert_allclose(motion.joint_pos, expected.joint_pos, atol=1e-12)
    np.testing.assert_allclose(motion.root_pos, expected.root_pos, atol=1e-12)
    assert angle_between(motion.root_quat_wxyz, expected.root_quat_wxyz).max() < 1e-7
    np.testing.assert_array_equal(open_session(path).motion().joint_pos, motion.joint_pos)
    assert load_motion(path, fps=100).n_frames == 100


def test_a_session_in_which_nothing_was_played_is_an_error(write_played):
    with pytest.raises(RecordingError, match="No motion was played"):
        load_motion(write_played(np.arange(20) * 0.002, play=Phase.RAMP))


def test_ticks_that_were_skipped_are_filled_in(write_played, demo):
    times = 1.0 + np.arange(500) * 0.002
    motion = open_session(write_played(np.delete(times, np.r_[100:130, 200, 350:355]))).motion()
    assert motion.n_frames == 500
    expected = demo.sample_many(times).joint_pos
    np.testing.assert_allclose(motion.joint_pos, expected, atol=1e-3)
    np.testing.assert_allclose(motion.joint_pos[210:340], expected[210:340], atol=1e-6)


def test_at_the_rate_of_the_source_it_is_the_source(write_played):
    source = load_motion("demo")
    motion = open_session(write_played(np.arange(501) * 0.002)).motion(fps=30)
    assert (motion.fps, motion.n_frames) == (30, 31)
    np.testing.assert_allclose(motion.joint_pos, source.joint_pos[:31], atol=1e-6)
    np.testing.assert_allclose(motion.root_pos, source.root_pos[:31], atol=1e-6)
    assert angle_between(motion.root_quat_wxyz, source.root_quat_wxyz[:31]).max() < 1e-4


def test_frame_rates_that_give_no_motion(write_played):
    session = open_session(write_played(np.arange(20) * 0.002))
    with pytest.raises(MotionError, match=r"0.* frames per second"):
        session.motion(fps=0)
    with pytest.raises(MotionError, match="1 frame"):
        session.motion(fps=1)
