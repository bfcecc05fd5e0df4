from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from g1stream.errors import MotionError
from g1stream.motion.motion import Motion


def test_knows_its_length(make_motion):
    motion = make_motion(np.zeros((61, 1)), fps=30.0)
    assert motion.n_frames == 61
    assert motion.duration == 2.0


def test_arrays_are_read_only_copies(make_motion):
    root_pos = np.zeros((2, 3))
    motion = make_motion([[0.0], [1.0]], root_pos)
    root_pos[0, 0] = 5.0
    assert motion.root_pos[0, 0] == 0.0
    for array in (motion.joint_pos, motion.root_pos, motion.root_quat_wxyz):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1.0


def test_quaternions_become_unit_and_sign_continuous(make_motion):
    angles = np.linspace(0.0, 6.0, 20)
    true = np.stack([np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)], axis=1)
    signs = np.where(np.arange(20) % 3 == 1, -1.0, 1.0)
    motion = make_motion(np.zeros((20, 1)), quat=true * signs[:, None] * 1.7)
    np.testing.assert_allclose(motion.root_quat_wxyz, true, atol=1e-15)


def test_part_of_a_motion(wild_motion):
    part = wild_motion.frames(10, 25)
    assert part.n_frames == 15
    assert part.joint_names == wild_motion.joint_names
    np.testing.assert_array_equal(part.joint_pos, wild_motion.joint_pos[10:25])
    np.testing.assert_array_equal(part.root_pos, wild_motion.root_pos[10:25])
    np.testing.assert_allclose(part.root_quat_wxyz, wild_motion.root_quat_wxyz[10:25], atol=1e-15)


@pytest.mark.parametrize(("start", "stop"), [(-1, 5), (5, 5), (5, 6), (6, 5), (30, 41)])
def test_part_that_is_none(wild_motion, start, stop):
    with pytest.raises(MotionError, match=f"Frames {start} to {stop}.*40 frames"):
        wild_motion.frames(start, stop)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"fps": 0.0}, "0.0 frames a second"),
        ({"fps": float("nan")}, "nan frames a second"),
        ({"joint_pos": np.zeros((3, 1))}, r"joint_pos of shape \(3, 1\).*\(3, 2\)"),
        ({"root_pos": np.zeros((2, 3))}, r"root_pos of shape \(2, 3\).*\(3, 3\)"),
        ({"root_quat_wxyz": np.ones((3, 3))}, r"root_quat_wxyz of shape \(3, 3\).*\(3, 4\)"),
        ({"root_pos": [[0, 0, 0], [0, np.inf, 0], [0, 0, 0]]}, "not finite in root_pos, frame 1"),
        ({"root_quat_wxyz": [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]]}, "zero .* frame 2"),
        ({"joint_pos": np.zeros((1, 2))}, "has 1 frame[.]"),
    ],
)
def test_what_is_no_motion(fault, message):
    fields = {
        "name": "odd",
        "fps": 30.0,
        "joint_names": ("a", "b"),
        "joint_pos": np.zeros((3, 2)),
        "root_pos": np.zeros((3, 3)),
        "root_quat_wxyz": [[1, 0, 0, 0]] * 3,
    }
    with pytest.raises(MotionError, match=message):
        Motion(**(fields | fault))


def test_importing_the_room_is_cheap():
    code = (
        "import sys, g1stream.motion.readers, g1stream.motion.check; "
        "sys.exit(any(m in sys.modules for m in ('scipy', 'mujoco', 'yourdfpy', 'cyclonedds')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
