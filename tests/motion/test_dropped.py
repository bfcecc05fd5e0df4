"""What a robot with fewer joints leaves out of a motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from g1stream.motion.dropped import dropped_joints
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.session.motions import load_motion

LACKED = (
    *("waist_roll_joint", "waist_pitch_joint", "left_wrist_pitch_joint", "left_wrist_yaw_joint"),
    *("right_wrist_pitch_joint", "right_wrist_yaw_joint"),
)  # by a G1 with 23 joints


@pytest.fixture(scope="module")
def still():
    demo = load_motion("demo")
    return replace(demo, joint_pos=np.zeros_like(demo.joint_pos))


def bent(motion, joint, angle):
    q = motion.joint_pos.copy()
    q[1:, JOINT_NAMES.index(joint)] = angle
    return replace(motion, joint_pos=q)


def test_a_robot_with_all_joints_drops_none():
    assert dropped_joints(load_motion("demo"), G1.default()) is None


def test_joints_that_do_not_move_are_named_and_not_missed(still):
    found = dropped_joints(bent(still, "left_knee_joint", 1.0), G1.load("g1_23dof"))
    assert found.joints == LACKED
    assert found.moved == ()
    assert set(found.errors_mm.values()) == {(0.0, 0.0)}


def test_the_head_is_as_far_off_as_its_lever_says(still):
    found = dropped_joints(bent(still, "waist_pitch_joint", 0.2), G1.load("g1_23dof"))
    assert found.joints == LACKED
    assert found.moved == ("waist_pitch_joint",)
    mean, most = found.errors_mm["head"]
    lever = np.hypot(0.0002835, 0.41618)  # of the lidar, from the axis of the waist's pitch
    assert most == pytest.approx(2e3 * lever * np.sin(0.1), rel=1e-6)
    assert mean < most  # the first frame is upright
    assert found.errors_mm["left hand"][1] > 10.0


def test_a_wrist_moves_its_own_hand_only(still):
    found = dropped_joints(bent(still, "right_wrist_yaw_joint", 0.5), G1.load("g1_23dof"))
    assert found.moved == ("right_wrist_yaw_joint",)
    assert found.errors_mm["head"] == found.errors_mm["left hand"] == (0.0, 0.0)
    assert 0.0 < found.errors_mm["right hand"][0] < 100.0
