from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from g1stream.errors import MotionError
from g1stream.motion.motion import Motion
from g1stream.motion.spline import BLOCK
from g1stream.motion.trajectory import Trajectory


def frame_times(motion):
    return np.arange(motion.n_frames) / motion.fps


def between(motion, n=997):
    """Times that fall on no frame."""
    return np.linspace(0.0, motion.duration, n)[1:-1]


def rotation(quat_wxyz):
    return Rotation.from_quat(quat_wxyz, scalar_first=True)


@pytest.mark.parametrize("n_frames", [40, BLOCK + 1, BLOCK + 2, 2 * BLOCK + 5])
def test_a_trajectory_is_scipys_splines(n_frames):
    """Natural cubic splines, and a rotation spline; also if it is fitted in parts."""
    motion = made(n_frames)
    times, at = between(motion, max(997, 2 * n_frames)), frame_times(motion)
    point = Trajectory(motion).sample_many(times)
    for values, found in (
        (motion.joint_pos, (point.joint_pos, point.joint_vel, point.joint_acc)),
        (motion.root_pos, (point.root_pos, point.root_lin_vel, point.root_lin_acc)),
    ):
        spline = CubicSpline(at, values, bc_type="natural")
        for order in range(3):
            np.testing.assert_allclose(
                found[order], spline(times, order), rtol=1e-10, atol=10.0 ** (order - 10)
            )
    turns = RotationSpline(at, rotation(motion.root_quat_wxyz))
    assert (turns(times).inv() * rotation(point.root_quat_wxyz)).magnitude().max() < 1e-10
    np.testing.assert_allclose(point.root_ang_vel, turns(times, 1), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(point.root_ang_acc, turns(times, 2), rtol=1e-8, atol=1e-7)


def test_one_sample_is_the_same_as_many(wild_motion):
    for loop in (False, True):
        trajectory = Trajectory(wild_motion, loop=loop)
        times = np.linspace(-0.5, 3.0, 61)
        many = trajectory.sample_many(times)
        for row, t in enumerate(times):
            for one, batch in zip(trajectory.sample(t), many, strict=True):
                np.testing.assert_allclose(one, batch[row], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("degrees", [1e-7, 45.0, 179.0])
def test_two_frames_give_a_constant_angular_velocity(make_motion, degrees):
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.6, 0.0, -0.8]))
    quat = [[1.0, 0.0, 0.0, 0.0], turn.as_quat(scalar_first=True)]
    trajectory = Trajectory(make_motion([[0.0], [1.0]], quat=quat, fps=1.0))
    for t in (0.25, 0.5, 0.75):
        point = trajectory.sample(t)
        truth = Rotation.from_rotvec(t * turn.as_rotvec())
        assert (truth.inv() * rotation(point.root_quat_wxyz)).magnitude() < 1e-14
        np.testing.assert_allclose(point.root_ang_vel, turn.as_rotvec(), atol=1e-13)
        np.testing.assert_allclose(point.joint_pos[0], t, atol=1e-15)
        np.testing.assert_allclose(point.joint_vel[0], 1.0, atol=1e-15)


def test_a_loop_is_continuous_up_to_the_acceleration(wild_motion):
    """Also at the seam, and where it begins again."""
    trajectory, tiny = Trajectory(wild_motion, loop=True), 1e-10
    n_knots = round(trajectory.period * wild_motion.fps)
    knots = np.arange(1, n_knots + 1) / wild_motion.fps
    before, after = (trajectory.sample_many(knots + d) for d in (-tiny, tiny))
    steepest = np.abs(np.diff(after.joint_acc, axis=0)).max() * wild_motion.fps
    assert steepest < 1e5
    # Where it begins again the root may have made a whole turn, and q become -q.
    after.root_quat_wxyz[-1] *= np.sign(before.root_quat_wxyz[-1] @ after.root_quat_wxyz[-1])
    for name, left, right in zip(before._fields, before, after, strict=True):
        # With that slope a continuous function changes by up to 2e-5 in 2e-10 s.
        np.testing.assert_allclose(left, right, rtol=0, atol=2e-5, err_msg=name)


def test_rests_before_the_start_and_after_the_end(wild_motion):
    trajectory = Trajectory(wild_motion)
    for t, frame in ((-1.0, 0), (-1e-9, 0), (wild_motion.duration + 1e-9, -1), (1e9, -1)):
        point = trajectory.sample(t)
        np.testing.assert_allclose(point.joint_pos, wild_motion.joint_pos[frame], atol=1e-12)
        np.testing.assert_allclose(point.root_pos, wild_motion.root_pos[frame], atol=1e-12)
        quat = wild_motion.root_quat_wxyz[frame]
        np.testing.assert_allclose(point.root_quat_wxyz, quat, atol=1e-12)
        for rate in (point.joint_vel, point.joint_acc, *point[4:6], *point[7:]):
            assert not rate.any()


def made(n_frames, fps=30.0):
    """A random walk of every joint and of the root: nothing in it is smooth."""
    rng = np.random.default_rng(8)
    turning = rng.normal(scale=0.02, size=(n_frames, 4)).cumsum(axis=0)
    return Motion(
        name="walk",
        fps=fps,
        joint_pos=rng.normal(scale=0.1, size=(n_frames, 29)).cumsum(axis=0),
        root_pos=rng.normal(scale=0.01, size=(n_frames, 3)).cumsum(axis=0),
        root_quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]) + turning,
    )


def collected(motion, rate, start=0, stop=None):
    pieces = list(motion.samples(rate, start, motion.n_frames if stop is None else stop))
    numbers = np.concatenate([list(n) for n, _ in pieces])
    return numbers, [np.concatenate(parts) for parts in zip(*(p for _, p in pieces), strict=True)]


@pytest.mark.parametrize("rate", [100.0, 7.0])
def test_pieces_and_parts_are_those_of_the_spline_through_all_frames(rate):
    motion = made(2 * BLOCK + 5)
    numbers, fields = collected(motion, rate)
    np.testing.assert_array_equal(numbers, np.arange(len(numbers)))
    whole = Trajectory(motion).sample_many(numbers / rate)
    for field, expected in zip(fields[:7], whole[:7], strict=True):
        np.testing.assert_allclose(field, expected, atol=1e-8)
    part_numbers, part = collected(motion, rate, 150, 260)
    for field, expected in zip(part, fields, strict=True):
        np.testing.assert_allclose(field, expected[part_numbers], atol=1e-8)


@pytest.mark.parametrize(
    ("rate", "fps"), [(100.0, 30.0), (29.97, 30.0), (60.0, 29.97), (3.0, 30.0), (30.0, 30.0)]
)
def test_all_samples_between_the_first_and_the_last_frame(rate, fps):
    numbers, _ = collected(made(300, fps), rate, 100, 290)
    times = [Fraction(int(n)) / Fraction(repr(rate)) for n in numbers]
    first, last = 100 / Fraction(repr(fps)), 289 / Fraction(repr(fps))
    step = 1 / Fraction(repr(rate))
    assert first <= times[0] < first + step
    assert last - step < times[-1] <= last
    assert np.all(np.diff(numbers) == 1)


def test_the_last_sample_still_moves():
    """Rounding must not push it past the end, where a trajectory rests."""
    motion = made(31)
    _, fields = collected(motion, 90.0)
    assert np.abs(fields[1][-1]).max() > 0.1


@pytest.mark.parametrize(
    ("rate", "part", "message"),
    [
        (0.0, (0, 50), "walk"),
        (np.nan, (0, 50), "walk"),
        (1.0, (10, 20), "frames 10 and 19"),
    ],
)
def test_no_sample_is_an_error(rate, part, message):
    with pytest.raises(MotionError, match=message):
        list(made(50).samples(rate, *part))


@pytest.mark.parametrize("loop", [False, True])
def test_a_moved_trajectory_is_that_of_the_moved_motion(wild_motion, loop):
    other = replace(
        wild_motion, joint_pos=wild_motion.joint_pos[::-1], root_pos=wild_motion.root_pos + 0.1
    )
    moved = Trajectory(wild_motion, loop=loop).moved(other)
    assert (moved.motion, moved.loop) == (other, False)
    pairs = zip(
        *(one.sample_many(between(other)) for one in (moved, Trajectory(other))), strict=True
    )
    for found, expected in pairs:
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
