"""What is asked between frames, against the spline itself and the envelope that holds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from g1stream.config import Config
from g1stream.control.safety import Envelope
from g1stream.motion.check import check_motion
from g1stream.motion.readers import load_motion
from g1stream.motion.streamed import STREAM_RATE
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES

KNEE, WAIST = JOINT_NAMES.index("left_knee_joint"), JOINT_NAMES.index("waist_yaw_joint")


@pytest.fixture
def steps(make_motion, robot):
    """A knee that leaps to its upper limit and a waist that leaps to its lower one, and stay."""
    joints = np.zeros((61, len(JOINT_NAMES)))
    joints[20:, KNEE] = robot.upper[KNEE]
    joints[40:, WAIST] = robot.lower[WAIST]
    return make_motion(joints)


@pytest.mark.parametrize("rate", [500.0, 90.0])
@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_as_many_targets_are_held_as_the_envelope_holds(wild_motion, robot, rate, margin):
    joints = np.clip(8 * wild_motion.joint_pos, robot.lower + 1e-3, robot.upper - 1e-3)
    motion = replace(wild_motion, joint_pos=joints)
    envelope = Envelope(robot, Config().safety.model_copy(update={"position_margin": margin}))
    for i in range(int(motion.duration * rate + 1e-6) + 1):
        envelope.limit(Trajectory(motion).sample(i / rate).joint_pos)
    report = check_motion(motion, robot, rate=rate, position_margin=margin)
    held = {joint.joint: joint.n_targets for joint in report.held}
    assert report.limit_violations == ()
    assert held == {n: int(c) for n, c in zip(JOINT_NAMES, envelope.clamped, strict=True) if c}
    assert report.n_held == envelope.clamped.sum() > 10


def test_an_overshoot_is_told_where_it_is_furthest_out(steps, robot):
    report = check_motion(steps, robot)
    assert report.limit_violations == ()
    assert {joint.joint for joint in report.held} == {"waist_yaw_joint", "left_knee_joint"}
    excess = [abs(joint.value - joint.limit) for joint in report.held]
    assert excess == sorted(excess, reverse=True)
    times = np.arange(1001) / 500
    asked = Trajectory(steps).sample_many(times).joint_pos
    for joint in report.held:
        j = JOINT_NAMES.index(joint.joint)
        up = j == KNEE
        assert joint.limit == (robot.upper if up else robot.lower)[j]
        assert joint.value == pytest.approx((np.max if up else np.min)(asked[:, j]))
        assert joint.time == times[(np.argmax if up else np.argmin)(asked[:, j])]


def test_held_targets_are_no_fault_of_a_motion(make_motion, robot):
    joints = np.zeros((31, len(JOINT_NAMES)))
    joints[:, KNEE] = robot.upper[KNEE] - 0.4 * (np.arange(31) < 15)
    report = check_motion(make_motion(joints), robot)
    assert report.n_held
    assert report.within_limits


def test_the_speed_that_is_streamed_is_the_splines(steps, robot):
    asked = np.abs(Trajectory(steps).sample_many(np.arange(1001) / 500).joint_vel)
    report = check_motion(steps, robot)
    streamed = {speed.joint: speed for speed in report.fastest_streamed}
    knee = streamed["left_knee_joint"]
    assert knee.value == pytest.approx(asked[:, KNEE].max())
    assert knee.time == asked[:, KNEE].argmax() / 500
    assert knee.value > report.fastest.value


def test_the_rate_is_the_one_that_streams_by_default():
    assert Config().stream.rate == STREAM_RATE


def test_a_real_clip_is_faster_than_its_frames_and_overshoots(real_clip, robot):
    report = check_motion(load_motion(real_clip, robot), robot)
    assert report.within_limits
    fastest = max(report.fastest_streamed, key=lambda speed: speed.value)
    assert fastest.joint == "left_shoulder_pitch_joint"
    assert fastest.value == pytest.approx(36.07, abs=0.01)
    assert report.n_held == 119
    assert report.held[0].joint == "right_ankle_pitch_joint"
