"""Parts of a motion on the feet: what is tried is what is played."""

from __future__ import annotations

import numpy as np
import pytest

from g1stream.extras.physics.example_motions import squatting
from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.instead import Part, longest_part
from g1stream.extras.physics.stance import stand, stand_part
from g1stream.motion.motion import Motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.robot.soles import Soles

ROBOT = G1.default()


@pytest.fixture(scope="module")
def obstructed():
    """4 s of squats; a foot slides from 1.4 to 1.6 s, both are in the air from 2.2 to 2.3 s."""
    squat = squatting(4.0)
    pos, root = squat.joint_pos.copy(), squat.root_pos.copy()
    for joint, by in (("left_hip_roll_joint", 0.25), ("left_ankle_roll_joint", -0.25)):
        pos[70:80, JOINT_NAMES.index(joint)] += by
    root[110:115, 2] += 0.2
    return Motion.from_arrays(pos, root, fps=squat.fps)


def found_in(motion, frames):
    """The part that is found in frames that cannot be played as a whole."""
    with pytest.raises(CannotStandError) as raised:
        stand_part(motion, ROBOT, frames)
    return longest_part(motion, ROBOT, frames, raised.value.frames)


def test_the_longest_part_is_found_behind_several_obstacles(obstructed):
    part = found_in(obstructed, range(obstructed.n_frames))
    assert (part.start_s, part.start_s + part.duration_s) == pytest.approx((2.4, 4.0), abs=0.041)
    stand(obstructed.trim(part.start_s, part.start_s + part.duration_s), ROBOT)
    early = found_in(obstructed, range(110))
    assert (early.start_s, early.start_s + early.duration_s) == pytest.approx((0, 1.3), abs=0.041)
    assert found_in(obstructed, range(60, 130)) is None  # shorter than a second


def test_what_is_not_played_says_nothing_about_the_feet():
    """The left foot drifts by 0.18 m in the first 4 s, and then stands for a minute."""
    squat = squatting(64.0, arms=0.0)
    drift = np.minimum(np.arange(squat.n_frames) / (4.0 * squat.fps), 1.0)
    pos = squat.joint_pos.copy()
    for joint, by in (("left_hip_roll_joint", 0.27), ("left_ankle_roll_joint", -0.27)):
        pos[:, JOINT_NAMES.index(joint)] += by * drift
    motion = Motion.from_arrays(pos, squat.root_pos, fps=squat.fps)
    with pytest.raises(CannotStandError, match="slides"):
        stand(motion, ROBOT)
    standing = stand_part(motion, ROBOT, range(201))
    played = standing.motion
    assert played.n_frames == motion.n_frames
    corners = Soles(ROBOT).path(played.joint_pos, played.root_pos, played.root_quat_wxyz)
    assert np.ptp(corners, axis=0) == pytest.approx(np.zeros((8, 3)), abs=1e-5)
    assert standing.moved_mm < 60.0  # from the middle of the drift, half of it for each foot
    changed = np.abs(played.joint_pos[:201] - motion.joint_pos[:201]).max()
    assert np.degrees(changed) == pytest.approx(standing.joint_deg)


def test_frames_that_forbid_a_part_are_in_it(obstructed):
    """A hop began before: a pause in its middle stands for what is not played."""
    with pytest.raises(CannotStandError, match="no foot is on the floor") as raised:
        stand_part(obstructed, ROBOT, range(112, 200))
    assert np.flatnonzero(raised.value.frames).tolist() == [112, 113, 114]


def test_a_part_in_which_nothing_moves_is_not_named():
    """The robot rests for 3 s before it squats, and slides in between."""
    squat = squatting(1.5)
    rows = np.concatenate([np.zeros(150, int), np.arange(squat.n_frames)])
    resting = squat.at_frames(rows)
    root = resting.root_pos.copy()
    root[150:160, 0] += 0.3
    motion = Motion.from_arrays(resting.joint_pos, root, fps=50.0)
    assert found_in(motion, range(len(rows))).start_s >= 3.2
    still = Motion.from_arrays(resting.joint_pos[:150], root[:150], fps=50.0)
    waving = still.joint_pos.copy()
    waving[:, JOINT_NAMES.index("left_elbow_joint")] = np.linspace(0.0, 1.0, 150)
    waving = Motion.from_arrays(waving, root[:150], fps=50.0)
    none, waist = np.zeros(150, np.bool_), ROBOT.select("waist")
    assert longest_part(still, ROBOT, range(150), none) is None
    assert longest_part(waving, ROBOT, range(150), none) is not None
    assert longest_part(waving, ROBOT, range(150), none, waist) is None


@pytest.mark.parametrize("fps", [24.0, 30.0, 50.0, 60.0, 119.88, 120.0])
def test_a_part_is_within_its_frames(fps):
    for first in range(200):
        part = Part.of_frames(range(first, first + 100), fps)
        assert part.start_s >= first / fps - 1e-9
        assert part.start_s + part.duration_s <= (first + 99) / fps + 1e-9
        assert part.duration_s > 99 / fps - 0.02
