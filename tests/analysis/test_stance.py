"""A motion with planted feet: against kinematics, dynamics and the limits of the soles."""

from __future__ import annotations

import numpy as np
import pytest

from g1stream.analysis.ground import beyond_support, touching
from g1stream.analysis.stance import on_standing_legs, stand
from g1stream.errors import MotionError
from g1stream.motion.motion import Motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_rpy
from g1stream.robot.soles import OFF_FLOOR, Soles
from g1stream.robot.standing import BodyState, StandingDynamics
from g1stream.session.motions import load_motion
from g1stream.synthetic import squatting

ROBOT = G1.default()
SOLES = Soles(ROBOT)


def corners_of(motion):
    poses = forward_kinematics(ROBOT, motion.joint_pos, motion.root_pos, motion.root_quat_wxyz)
    return SOLES.positions(poses)


@pytest.fixture(scope="module")
def squat():
    return squatting(4.0)


def test_the_feet_stand_still_and_flat_on_the_floor(squat):
    corners = corners_of(stand(squat, ROBOT).motion)
    assert np.ptp(corners, axis=0) == pytest.approx(np.zeros((8, 3)), abs=1e-5)
    assert corners[..., 2].min() == pytest.approx(0.0, abs=1e-5)
    assert corners[..., 2].max() == pytest.approx(0.0, abs=1e-3)  # a corner is 0.7 mm higher
    assert touching(corners, squat.fps)[0].all()


def test_only_the_legs_are_changed_and_little(squat):
    standing = stand(squat, ROBOT)
    change = np.abs(standing.motion.joint_pos - squat.joint_pos)
    assert change[:, 12:].max() == 0.0
    assert np.degrees(change.max()) == pytest.approx(standing.joint_deg)
    assert JOINT_NAMES[int(change.max(axis=0).argmax())] == standing.joint
    assert standing.joint_deg < 1.0
    assert standing.moved_mm < 5.0
    assert np.array_equal(standing.motion.root_quat_wxyz, squat.root_quat_wxyz)


def test_stretched_legs_are_bent(squat):
    straight = Motion.from_arrays(np.zeros((20, 29)), np.tile([0, 0, 0.79], (20, 1)), fps=50.0)
    standing = stand(straight, ROBOT)
    knees = [JOINT_NAMES.index(f"{side}_knee_joint") for side in ("left", "right")]
    assert standing.motion.joint_pos[:, knees].min() >= 0.12
    assert 0.0 < standing.lowered_mm < 20.0


def test_the_mass_is_kept_over_the_soles():
    """Leant forward by 0.6 rad at the hips, the robot would fall on its face."""
    squat = squatting(2.0, arms=0.0)
    leant = squat.joint_pos.copy()
    for side in ("left", "right"):
        leant[:, JOINT_NAMES.index(f"{side}_hip_pitch_joint")] -= 0.6
        leant[:, JOINT_NAMES.index(f"{side}_shoulder_pitch_joint")] = -1.5
    quat = np.tile(quat_from_rpy(np.array([0.0, 0.6, 0.0])), (len(leant), 1))
    standing = stand(Motion.from_arrays(leant, squat.root_pos, quat, fps=squat.fps), ROBOT)
    assert standing.shifted_mm > 10.0
    still = standing.motion.frames(0, 2)
    state = BodyState(still.root_quat_wxyz[0], np.zeros(3), still.joint_pos[0], np.zeros(29))
    none = np.zeros(3), np.zeros(3), np.zeros(29)
    centre = StandingDynamics(ROBOT).movement(state, still.root_pos[0], np.zeros(3), none).pos
    corners = corners_of(still)[:1]
    assert beyond_support(centre[np.newaxis, :2], corners, np.ones((1, 8), bool)) < -0.015


def test_a_foot_that_steps_is_refused_with_its_frames(squat):
    stepping = squat.joint_pos.copy()
    stepping[50:60, JOINT_NAMES.index("left_hip_roll_joint")] += 0.25
    stepping[50:60, JOINT_NAMES.index("left_ankle_roll_joint")] -= 0.25
    with pytest.raises(MotionError, match="left foot steps in frames 50 to 59"):
        stand(Motion.from_arrays(stepping, squat.root_pos, fps=squat.fps), ROBOT)


def test_a_foot_that_is_lifted_too_fast_for_the_mass_is_refused_with_its_frames(squat):
    lifted = squat.joint_pos.copy()
    lifted[50:60, JOINT_NAMES.index("left_knee_joint")] += 0.6
    with pytest.raises(MotionError, match="frames"):
        stand(Motion.from_arrays(lifted, squat.root_pos, fps=squat.fps), ROBOT)


def test_the_demo_lifts_its_feet_one_by_one_and_puts_them_back_where_they_stood():
    demo = load_motion("demo")
    motion = stand(demo, ROBOT).motion
    feet = corners_of(motion).reshape(-1, 2, 4, 3)
    up = feet[..., 2].min(axis=2) > OFF_FLOOR
    assert not up.all(axis=1).any()
    assert [np.count_nonzero(np.diff(one.astype(int)) == 1) for one in up.T] == [2, 2]
    for foot in (0, 1):
        standing = feet[~up[:, foot], foot]
        assert np.ptp(standing, axis=0) == pytest.approx(np.zeros((4, 3)), abs=2e-3)
    assert feet[..., 2].max() > 0.1


def test_arms_play_on_legs_that_stand(squat):
    """Of a motion that turns and walks, the arms and the waist are left."""
    walking = Motion.from_arrays(
        squat.joint_pos + 0.1, squat.root_pos + np.arange(len(squat.root_pos))[:, None], fps=50.0
    )
    played = ROBOT.select("arms")
    changed = on_standing_legs(walking, ROBOT, played)
    assert np.array_equal(changed.joint_pos[:, played], walking.joint_pos[:, played])
    assert np.ptp(changed.joint_pos[:, ~played], axis=0).max() == 0.0
    assert not changed.joint_pos[:, 12:15].any()
    standing = stand(changed, ROBOT)
    assert standing.lowered_mm == 0.0
    assert corners_of(standing.motion)[..., 2].min() == pytest.approx(0.0, abs=1e-5)


def test_a_motion_that_ends_on_one_foot_is_refused():
    demo = load_motion("demo")
    with pytest.raises(MotionError, match="lifted at the beginning or the end, in frames 62 to 62"):
        stand(demo.frames(200, 263), ROBOT)
