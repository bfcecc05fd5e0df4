import numpy as np
import pytest

from g1stream.motion.motion import Motion
from g1stream.robot.joints import JOINT_NAMES
from known_robots import real_clip, robot

__all__ = ["real_clip", "robot"]


@pytest.fixture
def make_motion():
    """A motion of which only some is given; joints not given are still, so is the root."""

    def make(joint_pos, root_pos=None, quat=None, fps=30.0):
        given = np.atleast_2d(np.asarray(joint_pos, dtype=float))
        joints = np.zeros((len(given), len(JOINT_NAMES)))
        joints[:, : given.shape[1]] = given
        n_frames = len(joints)
        return Motion(
            name="made",
            fps=fps,
            joint_pos=joints,
            root_pos=np.zeros((n_frames, 3)) if root_pos is None else root_pos,
            root_quat_wxyz=np.tile([1.0, 0, 0, 0], (n_frames, 1)) if quat is None else quat,
        )

    return make


@pytest.fixture
def wild_motion(make_motion):
    """Forty frames in which everything turns and moves, ends included."""
    rng = np.random.default_rng(7)
    quat = np.array([1.0, 0.3, -0.2, 0.5]) + np.cumsum(rng.normal(size=(40, 4)) * 0.08, axis=0)
    joints = np.cumsum(rng.normal(size=(40, len(JOINT_NAMES))) * 0.05, axis=0)
    return make_motion(joints, np.cumsum(rng.normal(size=(40, 3)) * 0.02, axis=0), quat)
