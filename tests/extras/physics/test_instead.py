import pickle
import re

import numpy as np
import pytest

from g1stream.extras.physics.example_motions import squatting
from g1stream.extras.physics.footing import CannotStandError
from g1stream.extras.physics.stance import stand, stand_part
from g1stream.extras.physics.standing import find_instead
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


def test_the_longest_part_is_found_behind_several_obstacles(obstructed):
    """In all of it, before the hop, and in what is too short."""
    for frames, expected in (
        (range(obstructed.n_frames), (2.4, 4.0)),
        (range(110), (0.0, 1.3)),
        (range(60, 130), None),
    ):
        with pytest.raises(CannotStandError) as raised:
            stand_part(obstructed, ROBOT, frames)
        copy = pickle.loads(pickle.dumps(raised.value))  # as from a pool of processes
        assert (type(copy), copy.cause, copy.remedy) == (
            CannotStandError,
            raised.value.cause,
            raised.value.remedy,
        )
        found = find_instead(obstructed, ROBOT, frames, raised.value)
        part = re.search(r"--start (\S+) --duration (\S+), the longest part", found)
        assert bool(part) == bool(expected)
        if part:
            start, duration = map(float, part.groups())
            assert (start, start + duration) == pytest.approx(expected, abs=0.041)
            stand(obstructed.trim(start, start + duration), ROBOT)


def test_what_is_not_played_says_nothing_about_the_feet():
    """The left foot drifts by 0.18 m in the first 4 s, and then stands for 16 s."""
    squat = squatting(20.0, arms=0.0)
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
