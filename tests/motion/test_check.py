from dataclasses import replace

import numpy as np
import pytest

from g1stream.motion.check import check_motion, dropped_joints
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1

KNEE = JOINT_NAMES.index("left_knee_joint")


@pytest.fixture
def still(make_motion):
    return make_motion(np.zeros((31, len(JOINT_NAMES))))


def with_joint(motion, joint, values):
    joint_pos = motion.joint_pos.copy()
    joint_pos[:, joint] = values
    return replace(motion, joint_pos=joint_pos)


def test_position_limits_on_both_sides(still, robot):
    values = np.zeros(31)
    values[10:13] = robot.upper[KNEE] + [0.1, 0.3, 0.2]
    values[20] = robot.lower[KNEE] - 0.5
    report = check_motion(with_joint(still, KNEE, values), robot)
    (knee,) = report.frames_beyond
    assert (knee.joint, knee.count, knee.time) == ("left_knee_joint", 4, 20 / 30)
    assert knee.value == pytest.approx(robot.lower[KNEE] - 0.5)
    assert knee.limit == robot.lower[KNEE]
    assert not report.within_limits
    assert report.largest_step.frame == 12
    assert report.largest_step.value == pytest.approx(robot.upper[KNEE] + 0.2)


@pytest.mark.parametrize(("beyond", "within"), [(0.0, True), (5e-7, True), (2e-6, False)])
def test_six_decimals_of_a_limit_are_within_it(still, robot, beyond, within):
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
    assert report.groups["waist"] == (pytest.approx(-0.9), 0.0)


def test_root_travel(make_motion, robot):
    """Round a square of 1 m and half way along the next side."""
    corners = np.array(
        [[0, 0, 0.7], [1, 0, 0.9], [1, 1, 0.8], [0, 1, 0.8], [0, 0, 0.8], [0.5, 0, 0.8]]
    )
    report = check_motion(make_motion(np.zeros((6, 1)), corners), robot)
    assert report.root.path == pytest.approx(4.5)
    assert report.root.displacement == pytest.approx(0.5)
    assert (report.root.lowest, report.root.highest) == (0.7, 0.9)


def test_a_real_clip(real_clip, robot):
    motion = load_motion(real_clip)
    report = check_motion(motion, robot)
    assert (report.n_frames, report.fps) == (3945, 30.0)
    assert report.duration == pytest.approx(131.4667, abs=1e-4)
    assert report.warnings == ()
    assert report.within_limits
    assert report.fastest.joint == "left_shoulder_pitch_joint"
    assert report.fastest.value == pytest.approx(21.9, abs=0.05)
    streamed = max(report.streamed.speeds, key=lambda speed: speed.value)
    assert streamed.joint == "left_shoulder_pitch_joint"
    assert streamed.value == pytest.approx(36.07, abs=0.01)  # between two frames
    assert report.streamed.n_held == 117
    assert report.streamed.held[0].joint == "right_ankle_pitch_joint"
    assert report.largest_step.value == pytest.approx(1.079, abs=1e-3)
    assert report.largest_step.frame == 3067


@pytest.mark.parametrize(
    ("angles", "positions", "looks"),
    [
        (180 / np.pi, 1.0, "in degrees"),
        (1.0, 100.0, "in centimetres"),
        (1.0, 1000.0, "in millimetres"),
    ],
)
def test_other_units_are_a_problem(robot, angles, positions, looks):
    demo = load_motion("demo")
    scaled = replace(demo, joint_pos=angles * demo.joint_pos, root_pos=positions * demo.root_pos)
    report = check_motion(scaled, robot)
    assert looks in report.suspicion
    assert not report.passed
    assert not report.in_si_units


LACKED = (
    *("waist_roll_joint", "waist_pitch_joint", "left_wrist_pitch_joint", "left_wrist_yaw_joint"),
    *("right_wrist_pitch_joint", "right_wrist_yaw_joint"),
)  # by a G1 with 23 joints


def test_a_robot_with_all_joints_drops_none(still, robot):
    assert dropped_joints(still, robot) is None


@pytest.mark.parametrize("joint", ["left_knee_joint", "waist_pitch_joint"])
def test_joints_that_a_robot_lacks_are_named_and_missed_where_they_move(still, joint):
    moving = with_joint(still, JOINT_NAMES.index(joint), np.arange(31) == 7)
    found = dropped_joints(moving, G1.load("g1_23dof"))
    assert found.joints == LACKED
    assert found.moved == tuple({joint}.intersection(LACKED))
