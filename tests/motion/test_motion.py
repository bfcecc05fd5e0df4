"""Motions made from arrays, cut, resampled, saved and drawn."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from g1stream.errors import G1StreamError, MotionError, RecordingError
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.session.motions import load_motion

KNEE = JOINT_NAMES.index("left_knee_joint")


def test_length_and_repr(make_motion):
    motion = make_motion(np.zeros((61, 1)), fps=30.0)
    assert motion.n_frames == 61
    assert motion.duration == 2.0
    assert repr(motion) == "Motion(name='made', fps=30, n_frames=61, duration=2.00 s)"


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
    np.testing.assert_array_equal(part.joint_pos, wild_motion.joint_pos[10:25])
    np.testing.assert_array_equal(part.root_pos, wild_motion.root_pos[10:25])
    np.testing.assert_array_equal(part.root_quat_wxyz, wild_motion.root_quat_wxyz[10:25])


@pytest.mark.parametrize(("start", "stop"), [(-1, 5), (5, 5), (5, 6), (6, 5), (30, 41)])
def test_invalid_parts(wild_motion, start, stop):
    with pytest.raises(MotionError, match=f"{start} to {stop}.*40 frames"):
        wild_motion.frames(start, stop)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"fps": 0.0}, "0.0 frames per second"),
        ({"fps": float("nan")}, "nan frames per second"),
        ({"joint_pos": np.zeros((3, 1))}, r"joint_pos.*\(3, 1\).*\(3, 29\)"),
        ({"joint_pos": 1.0}, "1 frame"),
        ({"root_pos": np.zeros((2, 3))}, r"root_pos.*\(2, 3\).*\(3, 3\)"),
        ({"root_quat_wxyz": np.ones((3, 3))}, r"root_quat_wxyz.*\(3, 3\).*\(3, 4\)"),
        ({"root_pos": [[0, 0, 0], [0, np.inf, 0], [0, 0, 0]]}, "root_pos, frame 1"),
        ({"root_quat_wxyz": [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]]}, "zero .* frame 2"),
        ({"joint_pos": np.zeros((1, 2))}, "1 frame[.]"),
    ],
)
def test_invalid_arrays(fault, message):
    fields = {
        "name": "odd",
        "fps": 30.0,
        "joint_pos": np.zeros((3, 29)),
        "root_pos": np.zeros((3, 3)),
        "root_quat_wxyz": [[1, 0, 0, 0]] * 3,
    }
    with pytest.raises(MotionError, match=message):
        Motion(**(fields | fault))


def test_from_arrays_without_a_root_stays_at_the_origin():
    joint_pos = np.arange(58.0).reshape(2, 29)
    motion = Motion.from_arrays(joint_pos, fps=50)
    assert (motion.name, motion.fps, motion.joint_names) == ("motion", 50.0, JOINT_NAMES)
    np.testing.assert_array_equal(motion.joint_pos, joint_pos)
    assert motion.root_pos.tolist() == [[0.0, 0.0, 0.0]] * 2
    assert motion.root_quat_wxyz.tolist() == [[1.0, 0.0, 0.0, 0.0]] * 2


def test_from_arrays_with_a_root_and_names_in_another_order():
    order = JOINT_NAMES[::-1]
    motion = Motion.from_arrays(
        np.arange(58).reshape(2, 29),
        [[0, 0, 0.8], [0.1, 0, 0.8]],
        [[0, 0, 0, 2], [0, 0, 0, -2]],
        fps=30,
        joint_names=order,
        name="turned",
    )
    assert motion.joint_names == JOINT_NAMES
    assert motion.joint_pos[0].tolist() == list(range(28, -1, -1))
    assert motion.root_pos[1].tolist() == [0.1, 0.0, 0.8]
    assert motion.root_quat_wxyz.tolist() == [[0.0, 0.0, 0.0, 1.0]] * 2


@pytest.mark.parametrize(
    ("joint_pos", "names", "offender"),
    [
        (np.zeros((5, 28)), None, r"\(5, 28\)"),
        (np.zeros(29), None, r"\(29,\)"),
        (np.zeros((5, 29)), ("tail_joint", *JOINT_NAMES[1:]), "left_hip_pitch_joint.*tail_joint"),
        (np.zeros((5, 30)), (*JOINT_NAMES, "left_knee_joint"), "30 names"),
        (np.zeros((5, 28)), JOINT_NAMES, r"\(5, 28\)"),
    ],
)
def test_from_arrays_that_do_not_fit(joint_pos, names, offender):
    with pytest.raises(MotionError, match=offender):
        Motion.from_arrays(joint_pos, fps=30, joint_names=names)


@pytest.mark.parametrize(("fps", "n_frames"), [(100.0, 131), (12.0, 16), (30.0, 40)])
def test_resampled_frames_are_those_of_the_trajectory(wild_motion, fps, n_frames):
    resampled = wild_motion.resample(fps)
    assert (resampled.fps, resampled.n_frames, resampled.name) == (fps, n_frames, "made")
    point = Trajectory(wild_motion).sample_many(np.arange(n_frames) / fps)
    np.testing.assert_allclose(resampled.joint_pos, point.joint_pos, atol=1e-12)
    np.testing.assert_allclose(resampled.root_pos, point.root_pos, atol=1e-12)
    np.testing.assert_allclose(resampled.root_quat_wxyz, point.root_quat_wxyz, atol=1e-12)


@pytest.mark.parametrize("fps", [0.0, 0.1])
def test_invalid_frame_rates_to_resample_at(wild_motion, fps):
    with pytest.raises(MotionError, match="made"):
        wild_motion.resample(fps)


def test_a_saved_motion_is_read_back_to_the_last_bit(wild_motion, tmp_path):
    path = tmp_path / "walk.csv"
    motion = wild_motion.resample(47.0)
    assert motion.save(path) == path
    assert len(path.read_text().splitlines()[0].split(",")) == 37
    loaded = load_motion(path, fps=motion.fps)
    assert (loaded.name, loaded.fps, loaded.warnings) == ("walk", 47.0, ())
    for field in ("joint_pos", "root_pos", "root_quat_wxyz"):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(motion, field))


def test_save_replaces_a_file_only_with_force(wild_motion, tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text("precious")
    with pytest.raises(RecordingError, match=r"walk\.csv"):
        wild_motion.save(path)
    assert path.read_text() == "precious"
    wild_motion.save(path, force=True)
    assert load_motion(path).n_frames == 40


@pytest.mark.parametrize("name", ["walk.bvh", "missing/walk.csv"])
def test_save_to_an_invalid_path(wild_motion, tmp_path, name):
    with pytest.raises(G1StreamError, match=name.split("/")[0]):
        wild_motion.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_plot_of_some_joints(wild_motion):
    (axis,) = wild_motion.plot(["left_knee_joint", "waist_yaw_joint"]).axes
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("time (s)", "angle (rad)")
    knee, waist = axis.lines
    assert (knee.get_label(), waist.get_label()) == ("left_knee_joint", "waist_yaw_joint")
    np.testing.assert_array_equal(knee.get_xdata(), np.arange(40) / 30)
    np.testing.assert_array_equal(knee.get_ydata(), wild_motion.joint_pos[:, KNEE])


def test_a_plot_of_all_joints_has_a_diagram_per_limb(wild_motion):
    axes = wild_motion.plot().axes
    assert [axis.get_title() for axis in axes] == [limb.replace("_", " ") for limb in JOINT_GROUPS]
    assert [line.get_label() for axis in axes for line in axis.lines] == list(JOINT_NAMES)
    assert axes[-1].get_xlabel() == "time (s)"


def test_a_plot_of_an_unknown_joint(wild_motion):
    with pytest.raises(MotionError, match=r"tail_joint.*left_knee_joint"):
        wild_motion.plot(["tail_joint"])


def test_importing_the_room_is_cheap():
    code = (
        "import sys, g1stream.motion.files, g1stream.motion.check; sys.exit(any(m in sys.modules "
        "for m in ('scipy', 'mujoco', 'matplotlib', 'cyclonedds', 'pydantic')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
