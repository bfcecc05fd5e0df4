from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from g1stream.errors import MotionError
from g1stream.motion.check import check_motion
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES

KNEE = JOINT_NAMES.index("left_knee_joint")


@pytest.fixture
def still(make_motion):
    joints = np.zeros((31, len(JOINT_NAMES)))
    return make_motion(joints)


def with_joint(motion, joint, values):
    joint_pos = motion.joint_pos.copy()
    joint_pos[:, joint] = values
    return replace(motion, joint_pos=joint_pos)


def test_nothing_to_complain_about(still, robot):
    report = check_motion(still, robot)
    assert report.within_limits
    assert report.limit_violations == ()
    assert report.too_fast == ()
    assert (report.n_frames, report.fps, report.duration) == (31, 30.0, 1.0)
    assert report.fastest.value == 0.0
    assert {group.group for group in report.groups} == set(JOINT_GROUPS)


def test_position_limits_on_both_sides(still, robot):
    values = np.zeros(31)
    values[10:13] = robot.upper[KNEE] + [0.1, 0.3, 0.2]
    values[20] = robot.lower[KNEE] - 0.5
    report = check_motion(with_joint(still, KNEE, values), robot)
    below, above = report.limit_violations
    assert below.joint == above.joint == "left_knee_joint"
    assert (below.frame, below.n_frames) == (20, 1)
    assert below.value == pytest.approx(robot.lower[KNEE] - 0.5)
    assert below.limit == robot.lower[KNEE]
    assert (above.frame, above.n_frames) == (11, 3)
    assert above.value == pytest.approx(robot.upper[KNEE] + 0.3)
    assert above.limit == robot.upper[KNEE]
    assert not report.within_limits


@pytest.mark.parametrize(("beyond", "within"), [(0.0, True), (5e-7, True), (2e-6, False)])
def test_at_the_limit_is_within_as_far_as_six_decimals_tell(still, robot, beyond, within):
    values = np.full(31, robot.upper[KNEE] + beyond)
    assert check_motion(with_joint(still, KNEE, values), robot).within_limits is within


def test_a_ramp_has_its_own_speed_and_step(still, robot):
    """0.1 rad a frame at 30 fps is 3 rad/s."""
    values = np.concatenate([np.zeros(5), np.arange(10) * -0.1, np.full(16, -0.9)])
    joint = JOINT_NAMES.index("waist_yaw_joint")
    report = check_motion(with_joint(still, joint, values), robot)
    assert report.fastest.joint == "waist_yaw_joint"
    assert report.fastest.value == pytest.approx(3.0)
    assert report.fastest.limit == robot.velocity[joint]
    assert 5 / 30 <= report.fastest.time <= 13 / 30
    assert report.largest_step.joint == "waist_yaw_joint"
    assert report.largest_step.value == pytest.approx(0.1)
    waist = next(group for group in report.groups if group.group == "waist")
    assert (waist.lowest, waist.highest) == (pytest.approx(-0.9), 0.0)


def test_faster_between_frames_than_the_limit(still, robot):
    """1 rad from one frame to the next is 30 rad/s at least, and a knee has less."""
    assert robot.velocity[KNEE] < 30.0
    values = np.where(np.arange(31) < 16, 0.2, 1.2)
    report = check_motion(with_joint(still, KNEE, values), robot)
    (knee,) = report.too_fast
    assert knee.joint == "left_knee_joint"
    assert knee.value > 30.0
    assert 15 / 30 <= knee.time <= 16 / 30
    assert not report.within_limits
    assert (report.largest_step.frame, report.largest_step.value) == (15, pytest.approx(1.0))


def test_root_travel(make_motion, robot):
    """Round a square of 1 m and half way along the next side."""
    corners = np.array(
        [[0, 0, 0.7], [1, 0, 0.9], [1, 1, 0.8], [0, 1, 0.8], [0, 0, 0.8], [0.5, 0, 0.8]]
    )
    report = check_motion(make_motion(np.zeros((6, 1)), corners), robot)
    assert report.root.path == pytest.approx(4.5)
    assert report.root.displacement == pytest.approx(0.5)
    assert (report.root.lowest, report.root.highest) == (0.7, 0.9)


def test_motion_of_another_robot(still, robot):
    other = replace(still, joint_names=JOINT_NAMES[::-1])
    with pytest.raises(MotionError, match="joints of the motion made are not those of the robot"):
        check_motion(other, robot)


def test_a_real_clip(real_clip, robot):
    motion = load_motion(real_clip, robot)
    report = check_motion(motion, robot)
    assert (report.n_frames, report.fps) == (3945, 30.0)
    assert report.duration == pytest.approx(131.4667, abs=1e-4)
    assert report.warnings == ()
    assert report.within_limits
    assert report.fastest.joint == "left_shoulder_pitch_joint"
    assert report.fastest.value == pytest.approx(21.9, abs=0.05)
    assert report.largest_step.value == pytest.approx(1.079, abs=1e-3)
    assert report.largest_step.frame == 3067


def test_the_same_clip_as_lafan1_distributes_it(real_clip, robot, tmp_path):
    lines = real_clip.read_text().splitlines()[1:]
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(line.split(",", 1)[1] for line in lines))
    labelled, distributed = load_motion(real_clip, robot), load_motion(bare, robot)
    for name in ("joint_pos", "root_pos", "root_quat_wxyz"):
        np.testing.assert_array_equal(getattr(labelled, name), getattr(distributed, name))
    assert distributed.joint_names == labelled.joint_names
