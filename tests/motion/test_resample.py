"""Samples taken by the piece, against the one spline through all frames and against scipy."""

from fractions import Fraction

import numpy as np
import pytest

from g1stream.errors import MotionError
from g1stream.motion.motion import Motion
from g1stream.motion.resample import resample
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES


def made(n_frames, fps=30.0):
    """A random walk of every joint and of the root: nothing in it is smooth."""
    rng = np.random.default_rng(8)
    turning = rng.normal(scale=0.02, size=(n_frames, 4)).cumsum(axis=0)
    return Motion(
        name="walk",
        fps=fps,
        joint_names=JOINT_NAMES,
        joint_pos=rng.normal(scale=0.1, size=(n_frames, 29)).cumsum(axis=0),
        root_pos=rng.normal(scale=0.01, size=(n_frames, 3)).cumsum(axis=0),
        root_quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]) + turning,
    )


def collected(motion, rate, start=0, stop=None):
    pieces = list(resample(motion, rate, start, motion.n_frames if stop is None else stop))
    numbers = np.concatenate([list(n) for n, _ in pieces])
    return numbers, [np.concatenate(parts) for parts in zip(*(p for _, p in pieces), strict=True)]


@pytest.mark.parametrize("rate", [100.0, 29.97, 7.0])
def test_pieces_are_the_spline_through_all_frames(rate):
    motion = made(700)
    numbers, fields = collected(motion, rate)
    np.testing.assert_array_equal(numbers, np.arange(len(numbers)))
    whole = Trajectory(motion).sample_many(numbers / rate)
    for field, expected in zip(fields[:6], whole[:6], strict=True):
        np.testing.assert_allclose(field, expected, atol=1e-8)
    np.testing.assert_allclose(fields[6], whole.root_quat_wxyz, atol=1e-8)


@pytest.mark.parametrize(
    ("rate", "fps"), [(100.0, 30.0), (29.97, 30.0), (60.0, 29.97), (3.0, 30.0)]
)
def test_samples_lie_between_the_first_frame_and_the_last_and_none_is_left_out(rate, fps):
    numbers, _ = collected(made(300, fps), rate, 100, 290)
    times = [Fraction(int(n)) / Fraction(repr(rate)) for n in numbers]
    first, last = 100 / Fraction(repr(fps)), 289 / Fraction(repr(fps))
    step = 1 / Fraction(repr(rate))
    assert first <= times[0] < first + step
    assert last - step < times[-1] <= last
    assert np.all(np.diff(numbers) == 1)


def test_a_part_has_the_samples_of_the_whole():
    motion = made(400)
    _, whole = collected(motion, 90.0)
    numbers, part = collected(motion, 90.0, 150, 260)
    for field, expected in zip(part, whole, strict=True):
        np.testing.assert_allclose(field, expected[numbers], atol=1e-8)


def test_at_the_frame_rate_the_samples_are_the_frames():
    motion = made(600)
    _, fields = collected(motion, 30.0)
    np.testing.assert_allclose(fields[0], motion.joint_pos, atol=1e-12)
    np.testing.assert_allclose(fields[3], motion.root_pos, atol=1e-12)
    np.testing.assert_allclose(fields[6], motion.root_quat_wxyz, atol=1e-12)


def test_the_last_sample_still_moves():
    """Rounding must not push it past the end, where a trajectory rests."""
    motion = made(31)
    _, fields = collected(motion, 90.0)
    assert np.abs(fields[1][-1]).max() > 0.1


@pytest.mark.parametrize(
    ("rate", "part", "message"),
    [
        (0.0, (0, 50), "cannot be sampled"),
        (np.nan, (0, 50), "cannot be sampled"),
        (1.0, (10, 20), "no sample between the frames 10 and 19"),
    ],
)
def test_what_gives_no_sample_is_said(rate, part, message):
    with pytest.raises(MotionError, match=message):
        list(resample(made(50), rate, *part))
