import numpy as np
import pytest

import g1stream
from g1stream.analysis.signals import signal
from g1stream.app.convert import convert
from g1stream.app.session import open_session
from g1stream.errors import RecordingError
from g1stream.motion.readers import find_motion, load_motion
from written_sessions import turned, wave

T0 = 1_700_000_000_000_000_000
PERIOD = 20_000_000
TIMES = T0 + np.arange(200) * PERIOD
BEHIND = np.arange(200) >= 100


@pytest.mark.parametrize("step_s", [3600, 0.5, -0.5, -3600])
def test_a_clock_that_was_set_takes_no_time(record, step_s):
    path = record(TIMES + round(step_s * 1e9) * BEHIND)
    motion = load_motion(path)
    assert (motion.n_frames, motion.fps) == (200, 50.0)
    np.testing.assert_allclose(motion.joint_pos, [wave(i) for i in range(200)], atol=1e-12)
    np.testing.assert_allclose(motion.root_pos[:, 2], 0.75 + 0.0005 * np.arange(200), atol=1e-12)
    (warning,) = motion.warnings
    assert f"{step_s:+.3f} s" in warning


def test_between_messages_that_were_lost_the_motion_is_a_straight_line(record):
    lost = 50
    path = record(TIMES + lost * PERIOD * BEHIND, angles=lambda i: wave(i + lost * (i >= 100)))
    motion = load_motion(path)
    assert motion.n_frames == 250
    line = wave(99) + np.linspace(0, 1, lost + 2)[:, None] * (wave(150) - wave(99))
    np.testing.assert_allclose(motion.joint_pos[99:151], line, atol=1e-9)
    np.testing.assert_allclose(motion.joint_pos[151:], [wave(i) for i in range(151, 250)])
    assert "1.02 s" in motion.warnings[0]


@pytest.mark.parametrize("step_s", [60, -60])
def test_a_recording_that_was_interrupted_is_refused(record, step_s):
    path = record(TIMES + step_s * 10**9 * BEHIND, angles=lambda i: wave(i + 65 * (i >= 100)))
    with pytest.raises(RecordingError, match="interrupted"):
        load_motion(path)


def test_a_prefix_of_all_names_is_dropped_and_told(record):
    path = record(TIMES, prefix="g1/")
    used = find_motion(path).open().evidence.used
    assert "g1/" in used["joint order"]
    assert used["pelvis"].startswith("g1/pelvis in world")
    np.testing.assert_array_equal(load_motion(path).joint_pos[7], wave(7))


def test_messages_with_some_joints_each_are_merged_and_told(record):
    path = record(TIMES, parts=(range(15), range(15, 29)))
    motion, evidence = load_motion(path), find_motion(path).open().evidence
    assert (motion.n_frames, motion.fps) == (200, 50.0)
    # The arms come 3 ms later, and are brought back to the legs' times, or the legs to theirs.
    truth = np.array([wave(i) for i in range(200)])
    np.testing.assert_allclose(motion.joint_pos[1:-1], truth[1:-1], atol=0.3 * 2 * np.pi / 800)
    assert "15" in evidence.used["joints"]
    assert "14" in evidence.used["joints"]


def test_quaternions_that_are_not_unit_are_told(record):
    path = record(TIMES, norm=0.97)
    motion = load_motion(path)
    assert "0.97" in motion.warnings[0]
    np.testing.assert_allclose(motion.root_quat_wxyz, turned(200), atol=1e-12)


def test_a_converted_motion_is_plotted(tmp_path):
    path, motion = tmp_path / "demo.mcap", g1stream.load_motion("demo")
    g1stream.convert("demo", path)
    (line,) = signal(open_session(path), "q").lines
    np.testing.assert_allclose(line.values, np.degrees(motion.joint_pos), atol=1e-9)
    np.testing.assert_allclose(line.time[[0, -1]], [0.0, motion.duration])
    assert signal(open_session(path), "dq").lines == ()


def test_the_input_file_is_not_overwritten(tmp_path):
    source = tmp_path / "clip.mcap"
    convert("demo", source)
    before = source.read_bytes()
    with pytest.raises(RecordingError, match=str(source)):
        convert(source, source, force=True)
    assert source.read_bytes() == before
