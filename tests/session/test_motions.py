"""Motions from motion files and from sessions."""

from dataclasses import replace

import pytest

from g1stream.dds.messages import Reference
from g1stream.errors import MotionError, RecordingError
from g1stream.motion.check import check_file
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.session.motions import check_motion_file, load_motion
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
    path = write()
    report = check_motion_file(path, ROBOT)
    assert (report.path, report.kind, report.fault) == (path, "session", "")
    assert (report.motion.n_frames, report.motion.fps) == (100, 500.0)
    assert report.motion.streamed.speeds[0].joint == "left_knee_joint"
    assert report.motion.streamed.speeds[0].value == pytest.approx(0.5)
    assert report.passed


def test_a_session_beyond_a_limit_fails(write):
    report = check_motion_file(write(begin=ROBOT.upper[KNEE]), ROBOT)
    assert report.motion.frames_beyond[0].count == 99
    assert not report.passed


def test_the_frame_rate_is_as_given(write):
    assert check_motion_file(write(), ROBOT, fps=100.0).motion.fps == 100.0


def test_a_session_of_another_robot_is_a_finding(write):
    report = check_motion_file(write(), replace(ROBOT, joint_names=JOINT_NAMES[::-1]))
    assert ROBOT.name in report.fault
    assert report.remedy
    assert not report.passed


def test_a_session_in_which_nothing_was_played_is_an_error(write):
    with pytest.raises(RecordingError, match="No motion was played"):
        check_motion_file(write(Phase.RAMP), ROBOT)


def test_motion_files_are_checked_too(tmp_path):
    assert check_motion_file("demo", ROBOT) == check_file("demo", ROBOT)


def test_a_path_that_is_neither(tmp_path):
    for read in (lambda path: check_motion_file(path, ROBOT), load_motion):
        with pytest.raises(MotionError, match=r"nowhere\.mcap"):
            read(tmp_path / "nowhere.mcap")
