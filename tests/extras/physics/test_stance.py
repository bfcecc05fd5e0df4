import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from g1stream.errors import MotionError
from g1stream.extras.feet.standing import BodyState, StandingDynamics
from g1stream.extras.physics.example_motions import squatting, stepping
from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.ground import beyond_support, touching, zero_moment_point
from g1stream.extras.physics.stance import on_standing_legs, stand
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_rpy, quat_rotate, yaw_of
from g1stream.robot.soles import OFF_FLOOR, Soles

ROBOT = G1.default()
SOLES = Soles(ROBOT)


def corners_of(motion):
    poses = forward_kinematics(ROBOT, motion.joint_pos, motion.root_pos, motion.root_quat_wxyz)
    return SOLES.positions(poses)


@pytest.fixture(scope="module")
def squat():
    return squatting(4.0)


@pytest.fixture(scope="module")
def standing(squat):
    return stand(squat, ROBOT)


def test_the_feet_stand_still_and_flat_on_the_floor(squat, standing):
    corners = corners_of(standing.motion)
    assert np.ptp(corners, axis=0) == pytest.approx(np.zeros((8, 3)), abs=1e-5)
    assert corners[..., 2].min() == pytest.approx(0.0, abs=1e-5)
    assert corners[..., 2].max() == pytest.approx(0.0, abs=1e-3)  # a corner is 0.7 mm higher
    assert touching(corners, squat.fps)[0].all()


def test_only_the_legs_are_changed_and_little(squat, standing):
    change = np.abs(standing.motion.joint_pos - squat.joint_pos)
    assert change[:, 12:].max() == 0.0
    assert np.degrees(change.max()) == pytest.approx(standing.joint_deg)
    assert JOINT_NAMES[int(change.max(axis=0).argmax())] == standing.joint
    assert standing.joint_deg < 1.0
    assert standing.moved_mm < 5.0
    assert np.array_equal(standing.motion.root_quat_wxyz, squat.root_quat_wxyz)


def test_a_motion_that_stands_is_played_as_it_is(standing):
    assert not str(stand(standing.motion, ROBOT))
    assert not re.search(r"\b0 mm", str(standing))


def test_stretched_legs_are_bent():
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


def test_a_squat_that_is_faster_than_the_robot_falls_is_refused():
    time = np.arange(200) / 50.0
    bend = 0.9 - 0.7 * np.cos(6.0 * np.pi * time)
    pos = np.zeros((len(time), 29))
    for side in ("left", "right"):
        for joint, share in (("hip_pitch", -0.5), ("knee", 1.0), ("ankle_pitch", -0.5)):
            pos[:, JOINT_NAMES.index(f"{side}_{joint}_joint")] = share * bend
    in_air = Motion.from_arrays(pos, np.tile([0.0, 0.0, 0.7], (len(time), 1)), fps=50.0)
    lowest = corners_of(in_air)[..., 2].min(axis=1, keepdims=True)
    with pytest.raises(MotionError, match="floor would have to pull"):
        stand(replace(in_air, root_pos=in_air.root_pos - [0.0, 0.0, 1.0] * lowest), ROBOT)


def test_the_demo_lifts_its_feet_one_by_one_and_puts_them_back_where_they_stood(standing_demo):
    feet = corners_of(standing_demo.motion).reshape(-1, 2, 4, 3)
    up = feet[..., 2].min(axis=2) > OFF_FLOOR
    assert not up.all(axis=1).any()
    assert [np.count_nonzero(np.diff(one.astype(int)) == 1) for one in up.T] == [2, 2]
    for foot in (0, 1):
        standing = feet[~up[:, foot], foot]
        assert np.ptp(standing, axis=0) == pytest.approx(np.zeros((4, 3)), abs=2e-3)
    assert feet[..., 2].max() > 0.1


#: x and y, m, and heading, rad, of the robot after each step: the left foot, the right one, ...
STEPS = [(0.12, 0.0, 0.0), (0.12, 0.0, 0.0), (0.12, 0.08, 0.5), (0.12, 0.08, 0.5)]
PERIOD = 1.6


def test_a_foot_that_steps_stands_where_the_motion_puts_it():
    source = stepping([*STEPS, *STEPS[-1:] * 2], period=PERIOD)
    motion = stand(source, ROBOT).motion
    feet = corners_of(motion).reshape(-1, 2, 4, 3)
    up = feet[..., 2].min(axis=2) > OFF_FLOOR
    assert [np.count_nonzero(np.diff(one.astype(int)) == 1) for one in up.T] == [3, 3]
    pose = motion.joint_pos, motion.root_pos, motion.root_quat_wxyz
    headings = yaw_of(forward_kinematics(ROBOT, *pose).quat_wxyz[:, SOLES.links])
    for k, (x, y, heading) in enumerate(STEPS):
        foot = k % 2
        down, lifted = PERIOD * (k + 1) + 0.8, PERIOD * (k + 3)
        first, stop = round(down * motion.fps) + 5, round(lifted * motion.fps) - 5
        link = np.array([0.0, 0.1 - 0.2 * foot, 0.0])
        turn = quat_from_rpy(np.array([0.0, 0.0, heading]))
        middle = quat_rotate(turn, link + SOLES.corners[foot].mean(axis=0))
        expected = [x + middle[0], y + middle[1]]
        stood = feet[first:stop, foot].mean(axis=1)
        assert stood[:, :2] == pytest.approx(np.tile(expected, (len(stood), 1)), abs=2e-3)
        assert headings[first:stop, foot] == pytest.approx(heading, abs=2e-3)
        assert np.ptp(stood, axis=0) == pytest.approx(np.zeros(3), abs=1e-4)


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


def test_an_error_has_all_frames_that_forbid_a_motion(squat):
    sliding = squat.joint_pos.copy()
    forbidden = np.zeros(squat.n_frames, bool)
    for first in range(20, 180, 40):
        forbidden[first : first + 10] = True
    for joint, by in (("left_hip_roll_joint", 0.25), ("left_ankle_roll_joint", -0.25)):
        sliding[forbidden, JOINT_NAMES.index(joint)] += by
    with pytest.raises(CannotStandError) as raised:
        stand(Motion.from_arrays(sliding, squat.root_pos, fps=squat.fps), ROBOT)
    assert np.array_equal(raised.value.frames, forbidden)
    assert not raised.value.slower


def test_joints_that_do_not_play_stand_still(squat):
    legs = stand(squat, ROBOT, ROBOT.select("legs"))
    assert np.ptp(legs.motion.joint_pos[:, 12:], axis=0).max() == 0.0
    assert np.ptp(legs.motion.joint_pos[:, :12], axis=0).max() > 0.3
    arms = stand(squat, ROBOT, ROBOT.select("arms"), Trajectory(squat))
    assert (legs.upper_body, arms.upper_body) == (False, True)
    assert np.array_equal(arms.motion.joint_pos[:, 15:], squat.joint_pos[:, 15:])
    assert np.ptp(arms.motion.root_quat_wxyz, axis=0).max() == 0.0
    corners = corners_of(arms.motion)
    assert np.ptp(corners, axis=0) == pytest.approx(np.zeros((8, 3)), abs=1e-5)


def jumping(jump):
    """Standing still, but for both shoulders that jump by an angle, rad, at frame 30."""
    pos = np.zeros((60, 29))
    for side in ("left", "right"):
        pos[30:, JOINT_NAMES.index(f"{side}_shoulder_pitch_joint")] = -jump
    motion = Motion.from_arrays(pos, np.tile([0, 0, 0.79], (60, 1)), fps=30.0)
    return on_standing_legs(motion, ROBOT, ROBOT.select("arms"))


def test_arms_that_jump_within_a_frame_do_not_tip_the_robot():
    assert stand(jumping(0.25), ROBOT).shifted_mm == pytest.approx(0.0, abs=5.0)


def test_the_pressure_of_a_changed_motion_is_inside_the_soles_in_every_frame(standing_demo):
    """Also in frames that the last attempts left as they were: MuJoCo computes all of them."""
    motion = standing_demo.motion
    dynamics, trajectory = InverseDynamics(ROBOT), Trajectory(motion)
    wrench = np.empty((motion.n_frames, 6))
    for k in range(motion.n_frames):
        point = trajectory.sample(k / motion.fps)
        base = BaseMotion(
            point.root_quat_wxyz,
            point.root_ang_vel,
            lin_acc=point.root_lin_acc,
            ang_acc=point.root_ang_acc,
        )
        solved = dynamics.solve("follow", point.joint_pos, point.joint_vel, point.joint_acc, base)
        force, turned = solved.wrench[:3], quat_rotate(point.root_quat_wxyz, solved.wrench[3:])
        wrench[k] = *force, *(turned + np.cross(point.root_pos, force))
    averaged = gaussian_filter1d(wrench, 0.05 * motion.fps, axis=0)  # a jump is over soon
    corners = corners_of(motion)
    floor = corners[..., 2].min()
    stands = (corners[..., 2].reshape(-1, 2, 4).min(axis=2) < floor + OFF_FLOOR).repeat(4, axis=1)
    beyond = [
        beyond_support(zero_moment_point(one[:, :3], one[:, 3:]), corners, stands)
        for one in (wrench, averaged)
    ]
    assert np.min(beyond, axis=0).max() < -0.018 + 5e-4


def test_legs_beyond_a_limit_are_refused_with_their_frames(squat):
    pitch = [
        i for i, name in enumerate(JOINT_NAMES) if re.search("hip_pitch|knee|ankle_pitch", name)
    ]
    pos = squat.joint_pos.copy()
    pos[:, pitch] *= 2.0
    ankle = JOINT_NAMES.index("left_ankle_pitch_joint")
    beyond = np.flatnonzero(pos[:, ankle] < ROBOT.lower[ankle])
    deep = Motion.from_arrays(pos, squat.root_pos, fps=squat.fps)
    with pytest.raises(MotionError, match="ankle_pitch_joint gets beyond its limit") as raised:
        stand(deep, ROBOT)
    named = [int(number) for number in re.findall(r"\d+", raised.value.cause)]
    assert named == pytest.approx([beyond[0], beyond[-1]], abs=3)


def hopping():
    squat = squatting(2.0)
    root = squat.root_pos.copy()
    root[50:60, 2] += 0.2
    return Motion.from_arrays(squat.joint_pos, root, fps=squat.fps)


@pytest.mark.parametrize(
    ("motion", "why"),
    [
        (hopping, "no foot is on the floor in frames 50 to 59"),
        (lambda: stepping(STEPS, period=0.3, swing=0.4), r"both feet .* in frames \d+ to \d+"),
        (lambda: stepping([(0.3, 0.0, 0.0)] * 2), r"centre of pressure .* in frames? \d+"),
        (lambda: load_motion("demo").frames(200, 263), r"lifted at .* in frames 57 to 62\."),
        (lambda: jumping(1.0), "the feet slip .* in frame 30"),
        (lambda: jumping(2.0), "the feet slip .* in frames 29 to 31"),
    ],
)
def test_what_cannot_be_played_is_refused_with_its_frames(motion, why):
    with pytest.raises(MotionError, match=why):
        stand(motion(), ROBOT)
