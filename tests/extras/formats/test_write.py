from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import g1stream
from g1stream.errors import ConfigError, MotionError, RecordingError, RobotError
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from known_arrays import OUTPUTS, arrays, close, written


def test_finite_velocities_are_differences_of_the_frames_in_the_file(wild_motion, tmp_path):
    found = arrays(wild_motion, "mjlab", tmp_path, velocities="finite")
    for pos, vel, n in (("joint_pos", "joint_vel", 29), ("body_pos_w", "body_lin_vel_w", 1)):
        steps = np.gradient(found[pos][:, :n].astype(float), 1 / 50, axis=0)
        close(found[vel][:, :n], steps, 1e-4)
    turned = Rotation.from_quat(found["body_quat_w"][:, 0], scalar_first=True)
    turn = (turned[2:] * turned[:-2].inv()).as_rotvec() * 25
    close(found["body_ang_vel_w"][1:-1, 0], turn, 1e-4)
    assert (found["body_ang_vel_w"][[0, -1], 0] == found["body_ang_vel_w"][[1, -2], 0]).all()
    spline = arrays(wild_motion, "mjlab", tmp_path)
    assert np.abs(spline["joint_vel"] - found["joint_vel"]).max() > 0.1


def test_a_half_turn_between_frames_has_a_velocity(make_motion, tmp_path):
    """And none of a robot that stands is none, not 0 / 0."""
    quat = np.tile([[1.0, 0, 0, 0], [0, 0, 0, 1.0]], (4, 1))
    motion = make_motion(np.zeros((8, 29)), quat=quat, fps=25)
    for one, speed in ((motion, 0.1), (make_motion(np.zeros((8, 29)), fps=25), 0.0)):
        found = arrays(one, "mjlab", tmp_path, velocities="finite")["body_ang_vel_w"]
        assert np.isfinite(found).all()
        assert np.abs(found).max() > speed if speed else not found.any()


def test_quaternions_are_continuous(make_motion, tmp_path):
    t = np.linspace(0.0, 3.0, 91)
    quat = np.stack([np.cos(3 * t), 0 * t, 0 * t, np.sin(3 * t)], axis=1)  # nearly three turns
    joints = np.zeros((91, 29))
    joints[:, 3] = 2.0 * np.sin(2 * t)
    found = arrays(make_motion(joints, quat=quat), "mjlab", tmp_path)["body_quat_w"]
    assert ((found[1:] * found[:-1]).sum(axis=-1) > 0.9).all()


@pytest.mark.parametrize("name", OUTPUTS)
def test_what_is_written_is_read_back(wild_motion, tmp_path, robot, name):
    """Angles within 1e-6 rad, bodies within 0.01 mm, the height as it was."""
    form = OUTPUTS[name]
    motion = replace(wild_motion, fps=60.0)
    expected = motion.resample(form.fps) if form.fps else motion
    found = g1stream.load_motion(
        written(motion, name, tmp_path), fps=60.0 if name == "csv" else None
    )
    assert found.fps == expected.fps
    assert len(found.warnings) == 3 * (name == "lafan1")  # joint order, pelvis, frame rate
    close(found.joint_pos, expected.joint_pos, 1e-6)
    close(found.root_pos, expected.root_pos, 1e-6)
    ours, theirs = (
        forward_kinematics(robot, one.joint_pos, one.root_pos, one.root_quat_wxyz).pos
        for one in (found, expected)
    )
    assert np.linalg.norm(ours - theirs, axis=-1).max() < 1e-5
    if form.fps is None:
        for part in ("joint_pos", "root_pos", "root_quat_wxyz"):
            np.testing.assert_array_equal(getattr(found, part), getattr(motion, part))


@pytest.mark.parametrize(
    ("name", "how", "error"),
    [
        ("lafan1", {"robot": G1.load("g1_23dof")}, RobotError),
        ("beyondmimic", {"robot": replace(G1.default(), ignored_joints=("thumb",))}, RobotError),
        ("gmr", {"velocities": "finite"}, MotionError),
        ("mjlab", {"velocities": "none"}, MotionError),
        ("Mjlab", {}, MotionError),
    ],
)
def test_what_a_format_cannot_hold_is_refused(wild_motion, tmp_path, name, how, error):
    with pytest.raises(error):
        wild_motion.save(tmp_path / "a.npz", format=name, **how)
    assert list(tmp_path.iterdir()) == []


def test_endings_existing_files_and_short_motions_are_refused(make_motion, wild_motion, tmp_path):
    with pytest.raises(ConfigError, match=r"\.npz"):
        wild_motion.save(tmp_path / "a.csv", format="mjlab")
    with pytest.raises(MotionError, match="frame"):
        written(make_motion(np.zeros((2, 29)), fps=50), "mjlab", tmp_path, velocities="finite")
    assert list(tmp_path.iterdir()) == []
    for name in ("mjlab", "sonic"):
        path = written(wild_motion, name, tmp_path)
        with pytest.raises(RecordingError, match="exists already"):
            wild_motion.save(path, format=name)
    (tmp_path / "written" / "mine.txt").touch()
    with pytest.raises(RecordingError, match=r"mine\.txt"):
        written(wild_motion, "sonic", tmp_path)


def test_a_failure_leaves_what_was_there(wild_motion, tmp_path):
    """A pelvis that is too far away for numbers in text."""
    path = written(wild_motion, "sonic", tmp_path)
    before = {one.name: one.read_bytes() for one in path.iterdir()}
    far = replace(wild_motion, root_pos=wild_motion.root_pos + 10_000)
    for name in ("sonic", "lafan1"):
        with pytest.raises(MotionError, match="10,000"):
            written(far, name, tmp_path)
    assert {one.name: one.read_bytes() for one in path.iterdir()} == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_motion_never_replaces_its_own_file(wild_motion, tmp_path):
    path = wild_motion.save(tmp_path / "one.npz")
    found = g1stream.load_motion(path)
    for motion in (found, found.then(found)):
        with pytest.raises(RecordingError, match="input"):
            motion.save(path, format="mjlab", force=True)
