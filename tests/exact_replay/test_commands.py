"""How far recorded commands may move a joint, by the time that they leave it."""

import numpy as np
import pytest

from g1stream.exact_replay.commands import _JITTER, find_jump
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1

N = 100
KNEE = JOINT_NAMES.index("left_knee_joint")
EVERY = np.arange(N)
#: Half a knee's speed at 500 Hz, rad per command.
HALF = 0.02


@pytest.fixture(scope="module")
def jump():
    """What is wrong with a knee's targets (n,), rad, at times (n,), s."""
    velocity = G1.load().velocity
    assert velocity[KNEE] == 20.0

    def find(targets, times, jitter=_JITTER, speed=1.0):
        q = np.zeros((len(targets), N_JOINTS), np.float32)
        q[:, KNEE] = targets
        return find_jump(times / speed, q, velocity, jitter / speed)

    return find


@pytest.mark.parametrize(
    ("step", "times", "problem"),
    [
        # What is usual excuses nothing.
        (1.9, EVERY * 0.0999, "by 1.900 rad in one step"),
        (0.6, EVERY / 30.0, "by 0.600 rad in one step at 0.033 s"),
        (0.95, EVERY // 2 * 0.05 + EVERY % 2 * 0.002, "rad/s allow 0.080 rad"),
        (0.09, EVERY / 500.0, "rad/s allow 0.080 rad"),
    ],
)
def test_a_joint_does_not_alternate_faster_than_it_can(jump, step, times, problem):
    assert problem in jump(step * (EVERY % 2), times)


def test_what_jitter_excuses_once_it_does_not_excuse_all_the_time(jump):
    problem = jump(0.07 * (EVERY % 2), EVERY / 500.0)
    assert "at 0.028 s" in problem
    assert "left_knee_joint would be 0.021 s late" in problem


def test_slow_commands_may_step_by_what_a_joint_can_do_in_20_ms(jump):
    assert not jump(0.39 * (EVERY % 2), EVERY * 0.0999)
    assert not jump(0.39 * (EVERY % 2), EVERY * 0.03)


def test_times_of_no_clock_have_no_jitter(jump):
    targets, times = 0.041 * (EVERY % 2), EVERY / 500.0
    assert not jump(targets[:20], times[:20])
    assert "allow 0.040" in jump(targets[:20], times[:20], jitter=0.0)


def test_slower_than_recorded_stamps_are_off_by_more(jump):
    """And faster by less: what was late was late in the time of the recording."""
    step, late = np.array([0.0, 0.039]), np.array([0.0, 0.0001])
    assert not jump(step, late)
    assert not jump(step, late, speed=0.5)
    assert "allow 0.021" in jump(step, late, speed=2.0)


def test_commands_of_almost_the_same_stamp_are_no_leap(jump):
    times = EVERY / 500.0 + np.where(EVERY % 10 == 3, 0.00195, 0.0)
    assert not jump(HALF * EVERY, times)


@pytest.mark.parametrize(("stall", "leaps"), [(10, False), (30, True)])
def test_a_publisher_may_make_up_for_a_stall(jump, stall, leaps):
    """At once with what it owes, unless that is more than joints can do in 20 ms and a bit."""
    times = EVERY / 500.0
    times[40 : 40 + stall] = times[40 + stall]
    assert bool(jump(HALF * EVERY * 1.8, times)) == leaps


def test_time_to_spare_is_not_saved(jump):
    """A robot that stood for long leaps no less."""
    targets = np.where(EVERY < 50, 0.0, 0.09)
    assert "at 0.100 s" in jump(targets, EVERY / 500.0)
