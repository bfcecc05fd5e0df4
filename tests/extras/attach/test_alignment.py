from dataclasses import replace

import numpy as np
import pytest

from g1stream.extras.attach.alignment import find_plays
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory

RATE = 60.0


def wandering(seed: int, seconds: float = 20.0) -> Motion:
    """A motion of all joints that never repeats: sums of sines of unrelated frequencies."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * 30) + 1)[:, np.newaxis, np.newaxis] / 30.0
    hertz, phase = rng.uniform(0.1, 1.5, (4, 29)), rng.uniform(0.0, 2.0 * np.pi, (4, 29))
    size = rng.uniform(0.02, 0.15, (4, 29))
    q = (size * np.sin(2.0 * np.pi * hertz * time + phase)).sum(axis=1)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(q), 1))
    place = np.tile([0.0, 0.0, 0.8], (len(q), 1))
    return Motion(f"wandering{seed}", 30.0, q, place, upright)


MOTION = Trajectory(wandering(1))
OTHER = Trajectory(wandering(2))


def played(start, speed=1.0, part=(0.0, 20.0), seconds=30.0, trajectory=MOTION):
    """Times and joints of a recording: before the part 1 s of a way to it, after it rest."""
    times = np.arange(0.0, seconds, 1.0 / RATE)
    at = speed * (times - start)
    q = trajectory.sample_joints(at.clip(*part))[0]
    away = np.clip(part[0] - at, 0.0, 1.0)[:, np.newaxis]
    return times, q + 0.5 * away


def only(alignment):
    assert len(alignment.plays) == 1
    assert not alignment.ambiguous
    return alignment.plays[0]


@pytest.mark.parametrize(
    ("start", "speed", "part"),
    [
        (7.31, 1.0, (0.0, 20.0)),
        (-8.0, 1.0, (10.0, 17.0)),  # began before the recording would have
        (4.0, 0.5, (3.0, 12.0)),
        (4.0, 2.0, (0.0, 20.0)),
    ],
)
def test_start_speed_and_part_are_found(start, speed, part):
    play = only(find_plays(*played(start, speed, part), MOTION))
    assert play.start == pytest.approx(start, abs=1e-3)
    assert play.speed == pytest.approx(speed, rel=1e-3)
    assert play.first == pytest.approx(part[0], abs=0.1)
    assert play.last == pytest.approx(part[1], abs=0.1 if part[1] < 20.0 else speed / RATE + 1e-3)
    assert play.similarity > 0.98
    assert play.joints.all()


def test_noise_jitter_and_a_missing_tenth_leave_the_time_exact():
    rng = np.random.default_rng(3)
    times, q = played(7.0)
    kept = (times < 13.0) | (times > 15.0)
    times = np.sort(times + rng.uniform(-5e-3, 5e-3, len(times)))[kept]
    q = q[kept] + rng.normal(0.0, 5e-3, (kept.sum(), 29))
    play = only(find_plays(times, q, MOTION))
    assert play.start == pytest.approx(7.0, abs=2e-3)
    assert play.speed == pytest.approx(1.0, rel=1e-3)
    assert (play.first, play.last) == pytest.approx((0.0, 20.0), abs=0.1)


def test_plays_are_in_order_of_the_time_at_which_they_were_played():
    times, q = played(3.0, part=(0.0, 8.0))
    _, later = played(2.0, part=(11.0, 19.5))
    q = np.where((times > 12.0)[:, np.newaxis], later, q)
    plays = find_plays(times, q, MOTION).plays
    assert [play.start for play in plays] == pytest.approx([3.0, 2.0], abs=1e-3)
    assert [play.first for play in plays] == pytest.approx([0.0, 11.0], abs=0.1)


def test_each_of_many_plays_is_found():
    short = Trajectory(wandering(6, 8.0))
    times = np.arange(0.0, 50.0, 1.0 / RATE)
    q = short.sample_joints(np.mod(times, 10.0) - 1.0)[0]
    assert [play.start for play in find_plays(times, q, short).plays] == pytest.approx(
        np.arange(1.0, 50.0, 10.0), abs=1e-3
    )


def test_a_gentle_play_in_a_long_rest_is_found():
    gentle = wandering(7, 15.0)
    trajectory = Trajectory(replace(gentle, joint_pos=0.3 * gentle.joint_pos))
    times = np.arange(0.0, 400.0, 0.05)
    q = trajectory.sample_joints(times - 200.0)[0]
    assert only(find_plays(times, q, trajectory)).start == pytest.approx(200.0, abs=2e-3)


def test_joints_that_rest_do_not_follow_and_the_error_is_without_the_mean():
    times, q = played(7.0)
    beside = 0.1 + 0.03 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 5.0 * times)[:, np.newaxis]
    assert only(find_plays(times, q + beside, MOTION)).rmse == pytest.approx(0.03, rel=0.02)
    q[:, :15] = 0.1
    play = only(find_plays(times, q, MOTION))
    assert play.start == pytest.approx(7.0, abs=1e-3)
    assert play.joints.tolist() == [False] * 15 + [True] * 14


def test_a_play_with_large_errors_ends_where_the_robot_stopped():
    times, q = played(7.0, part=(0.0, 10.0))
    hertz = np.linspace(0.2, 2.0, 29)
    q += 0.05 * np.sqrt(2.0) * np.sin(2.0 * np.pi * hertz * times[:, np.newaxis])
    play = only(find_plays(times, q, MOTION))
    assert (play.first, play.last) == pytest.approx((0.0, 10.0), abs=0.2)


@pytest.mark.parametrize(("start", "seconds"), [(7.5, 5.0), (0.0, 20.0)])
def test_another_motion_is_not_found(start, seconds):
    recorded = played(3.0 - start, 1.0, (start, start + seconds), seconds + 6.0, OTHER)
    assert find_plays(*recorded, MOTION).plays == ()


def test_a_part_of_a_motion_that_repeats_itself_is_ambiguous():
    frames = np.arange(480) % 160  # 5.3 s, three times
    motion = wandering(4)
    q = motion.joint_pos[frames]
    trajectory = Trajectory(
        Motion("again", 30.0, q, motion.root_pos[frames], motion.root_quat_wxyz[frames])
    )
    assert find_plays(*played(3.0, 1.0, (5.0, 10.0), 12.0, trajectory), trajectory).ambiguous


def test_rest_tells_nothing():
    times = np.arange(0.0, 20.0, 1.0 / RATE)
    alignment = find_plays(times, np.zeros((len(times), 29)), MOTION)
    assert (alignment.plays, alignment.rival) == ((), None)
