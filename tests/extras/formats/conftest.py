import numpy as np
import pytest

import g1stream
from g1stream.robot.model import G1
from known_arrays import ISAACLAB, Oracle
from known_motions import load, make_motion, wild_motion
from known_robots import real_clip, robot

__all__ = ["load", "make_motion", "real_clip", "robot", "wild_motion"]


@pytest.fixture(scope="module")
def motion():
    """The bundled motion, with the pelvis on its way and turning."""
    demo = g1stream.load_motion("demo")
    t = np.arange(demo.n_frames) / demo.fps
    quat = np.stack([np.cos(0.3 * t), 0.05 * np.sin(t), 0 * t, np.sin(0.3 * t)], axis=1)
    return g1stream.Motion.from_arrays(
        demo.joint_pos, demo.root_pos + t[:, None] * [0.1, 0.2, 0.0], quat, fps=50
    )


@pytest.fixture(scope="module")
def isaac_angles(motion):
    columns = np.empty_like(motion.joint_pos)
    columns[:, ISAACLAB] = motion.joint_pos
    return columns


@pytest.fixture
def npz(tmp_path):
    """Write arrays at 50 fps; gives the path."""

    def write(**arrays):
        np.savez(tmp_path / "motion.npz", **({"fps": 50} | arrays))
        return tmp_path / "motion.npz"

    return write


@pytest.fixture
def pkl(tmp_path):
    """Write the bytes of a pickle; gives the path."""

    def write(content):
        (tmp_path / "motion.pkl").write_bytes(content)
        return tmp_path / "motion.pkl"

    return write


@pytest.fixture(scope="module")
def oracle():
    return Oracle(G1.default())
