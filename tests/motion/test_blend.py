import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.motion.blend import coast, minimum_jerk
from g1stream.motion.trajectory import Trajectory

STEP = 1e-5


@pytest.fixture
def at_rest_at_both_ends(make_motion):
    """Two joints, a metre forward and a quarter turn, still at both ends."""
    x = np.concatenate([np.zeros(20), np.linspace(0, 1, 60), np.ones(20)])[:, None]
    quat = Rotation.from_rotvec(x * [0.0, 0.0, np.pi / 2]).as_quat(scalar_first=True)
    return make_motion(x * [1.2, -0.4], x * [1.0, 0.0, 0.0], quat)


def test_a_loop_keeps_the_frames_of_the_motion_and_repeats(wild_motion):
    trajectory = Trajectory(wild_motion, loop=True)
    assert trajectory.duration == wild_motion.duration
    times = np.arange(wild_motion.n_frames) / wild_motion.fps
    once, again = (trajectory.sample_many(times + n * trajectory.period) for n in (0, 2))
    for name in ("joint_pos", "root_pos", "root_quat_wxyz"):
        expected = getattr(wild_motion, name)
        np.testing.assert_allclose(getattr(once, name), expected, rtol=0, atol=1e-12)
    for first, third in zip(once, again, strict=True):
        np.testing.assert_allclose(first, third, rtol=1e-7, atol=1e-7)


def test_between_two_rests_the_seam_is_monotonic_and_keeps_its_peak_speed(at_rest_at_both_ends):
    trajectory = Trajectory(at_rest_at_both_ends, loop=True)
    seam = np.linspace(trajectory.duration, trajectory.period, 1000)
    point = trajectory.sample_many(seam)
    way = 1.2 - point.joint_pos[:, 0]
    assert way[0] == pytest.approx(0.0, abs=1e-12)
    assert way[-1] == pytest.approx(1.2, abs=1e-12)
    assert (np.diff(way) > -1e-4).all()
    np.testing.assert_allclose(point.joint_pos[:, 1] * -3, point.joint_pos[:, 0], atol=1e-12)
    np.testing.assert_allclose(point.root_pos[:, 0] * 1.2, point.joint_pos[:, 0], atol=1e-12)
    yaw = Rotation.from_quat(point.root_quat_wxyz, scalar_first=True).as_rotvec()[:, 2]
    np.testing.assert_allclose(yaw / (np.pi / 2), point.root_pos[:, 0], atol=1e-4)
    fastest = np.abs(point.root_ang_vel).max()
    assert 1.4 < fastest < 1.51
    assert np.abs(point.joint_vel).max() < fastest
    # The furthest to go is the quarter turn: 15/8 of it at 1.5 rad/s, rounded up to whole frames.
    needed = np.pi / 2 * 15 / 8 / 1.5
    assert needed <= trajectory.period - trajectory.duration < needed + 1 / 30


def test_a_motion_that_ends_where_it_began_gets_the_shortest_seam(make_motion):
    motion = make_motion(np.sin(np.linspace(0, 2 * np.pi, 61))[:, None])
    trajectory = Trajectory(motion, loop=True)
    assert trajectory.period - trajectory.duration == pytest.approx(0.5)


@pytest.mark.parametrize("end", ["last", "first"])
def test_an_end_in_motion_overshoots_by_a_fifth_of_its_coast(make_motion, end):
    """What moves at 2 rad/s coasts on by a fifth of 0.2 s of its way, and no more."""
    ramp = np.concatenate([np.zeros(30), np.arange(1, 31) / 30 * 2.0])
    if end == "first":
        ramp = ramp[::-1]
    quat = Rotation.from_rotvec(ramp[:, None] * [0.0, 0.0, 1.0]).as_quat(scalar_first=True)
    trajectory = Trajectory(make_motion(ramp[:, None], quat=quat), loop=True)
    seam = np.linspace(trajectory.duration, trajectory.period, 500)
    point = trajectory.sample_many(seam)
    yaw = Rotation.from_quat(point.root_quat_wxyz, scalar_first=True).as_rotvec()[:, 2]
    for angle in (point.joint_pos[:, 0], yaw):
        assert 0.05 < angle.max() - 2.0 < 2.0 * 0.2 * 0.2
        assert angle.min() > -1e-3


@pytest.mark.parametrize(("n_frames", "fps"), [(2, 30.0), (3, 1.0)])
def test_short_motions_loop_too(make_motion, n_frames, fps):
    motion = make_motion(np.arange(n_frames)[:, None] * 0.1, fps=fps)
    trajectory = Trajectory(motion, loop=True)
    for k in range(n_frames):
        t = k / fps + trajectory.period
        assert trajectory.sample(t).joint_pos[0] == pytest.approx(0.1 * k, abs=1e-9)


def test_minimum_jerk_starts_and_ends_at_rest():
    assert minimum_jerk(0.0) == (0.0, 0.0, 0.0)
    assert minimum_jerk(1.0) == (1.0, 0.0, 0.0)
    assert minimum_jerk(-0.5) == minimum_jerk(0.0)
    assert minimum_jerk(1.5) == minimum_jerk(1.0)
    assert minimum_jerk(0.5) == (0.5, 1.875, 0.0)


def test_coasting_starts_with_unit_velocity_and_ends_where_it_started():
    assert coast(0.0, 0.2) == (0.0, 1.0, 0.0)
    assert coast(0.2, 0.2) == coast(7.0, 0.2) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("polynomial", "end", "near"),
    [(minimum_jerk, 1.0, (1e-8, 1e-7)), (lambda x: coast(x, 0.2), 0.2, (1e-6, 1e-4))],
)
def test_derivatives_are_finite_differences_of_numbers_and_arrays(polynomial, end, near):
    at = np.linspace(0.01, end - 0.01, 15)
    before, here, after = (np.array(polynomial(at + d)) for d in (-STEP, 0.0, STEP))
    difference = (after - before) / (2 * STEP)
    np.testing.assert_allclose(here[1], difference[0], rtol=0, atol=near[0])
    np.testing.assert_allclose(here[2], difference[1], rtol=0, atol=near[1])
    values = np.linspace(-0.1, 1.1, 25)
    numbers = [polynomial(value) for value in values.tolist()]
    np.testing.assert_allclose(np.transpose(polynomial(values)), numbers, atol=1e-14)
