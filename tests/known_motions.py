"""Motions made for tests."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.errors import MotionError
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES

#: The columns of the Foxglove layout.
COLUMNS = ("Frame", "X", "Y", "Z", "QX", "QY", "QZ", "QW", *JOINT_NAMES)


def rows_of(n_frames, seed=0):
    """Rows of a table with these columns."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n_frames, 36))
    values[:, 3:7] = Rotation.random(n_frames, rng=rng).as_quat()
    return [[frame, *row] for frame, row in enumerate(values.tolist())]


def csv(rows, columns=COLUMNS):
    return "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows), ""])


def bare(rows):
    """Without header and frame numbers."""
    return csv([row[1:] for row in rows]).split("\n", 1)[1]


def changed(line, column, cell):
    """Five good frames but for one cell; lines and columns counted from 1."""
    lines = csv(rows_of(5)).split("\n")
    cells = lines[line - 1].split(",")
    cells[column - 1] = cell
    lines[line - 1] = ",".join(cells)
    return "\n".join(lines)


@pytest.fixture
def load(tmp_path):
    """Load a motion from the text or bytes of a table."""

    def load_content(content, **options):
        path = tmp_path / "clip.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return load_motion(path, **options)

    return load_content


def assert_read_or_refused(load, text):
    """A text is refused, or read as a motion of finite numbers."""
    try:
        motion = load(text.encode("utf-8", "surrogatepass"))
    except MotionError:
        return
    for array in (motion.joint_pos, motion.root_pos, motion.root_quat_wxyz):
        assert np.isfinite(array).all()


def assert_same(motion, other):
    for name in ("joint_pos", "root_pos", "root_quat_wxyz"):
        np.testing.assert_array_equal(getattr(motion, name), getattr(other, name))


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
