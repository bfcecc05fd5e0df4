from types import SimpleNamespace

import numpy as np
import pytest

from g1stream.control.reading import ImuReading, Reading
from g1stream.control.robot_clock import RobotClock

IMU = ImuReading(*(np.zeros(n) for n in (4, 3, 3)))
_MS = 1_000_000
_PERIOD = 2 * _MS
_SLACK = 10 * _MS


class Robot:
    """Publishes LowState every 2 ms of its time, `pace` times as fast as the clock."""

    def __init__(self, pace=1.0, ticks=True):
        self.time = RobotClock(pace)
        self.now = self.passed = self.published = 0.0
        self.pace, self.ticks = pace, ticks
        self._publish()
        self.time.begin(0)

    def _publish(self):
        tick = round(self.published / _MS) if self.ticks else 0
        self.time.take(SimpleNamespace(tick=tick, arrived=round(self.now)), moving=True)

    def run(self, seconds, *, silent=False):
        """Waits of each tick of the loop, ns."""
        waits = []
        for _ in range(round(seconds * 1e9 / _PERIOD)):
            self.now += _PERIOD
            self.passed += _PERIOD * self.pace
            if not silent and self.passed - self.published >= _PERIOD:
                self.published = self.passed
                self._publish()
            waits.append(self.time.wait(round(self.now)))
        return waits


@pytest.mark.parametrize("ticks", [True, False])
def test_a_motion_does_not_wait_for_a_robot_in_time(ticks):
    assert set(Robot(ticks=ticks).run(3.0)) == {0}


@pytest.mark.parametrize(("pace", "ticks"), [(0.5, True), (0.8, False)])
def test_a_motion_is_as_slow_as_the_simulator(ticks, pace):
    robot = Robot(pace, ticks)
    waits = robot.run(2.0)
    assert robot.time.delay == sum(waits)
    assert robot.time.delay == pytest.approx(2e9 * (1.0 - pace), abs=1.5 * _SLACK)
    assert max(waits) <= 2 * _PERIOD


@pytest.mark.parametrize("ticks", [True, False])
def test_a_motion_waits_while_no_lowstate_arrives_and_goes_on_where_it_was(ticks):
    """Also where the robot has gone on meanwhile, so that its tick leaps by 300 ms."""
    robot = Robot(ticks=ticks)
    robot.run(0.5)
    robot.run(0.3, silent=True)
    assert robot.time.delay == pytest.approx(0.3e9 - 2 * _SLACK, abs=_PERIOD)
    waits = robot.run(0.1)
    assert min(waits) >= -20 * _MS
    assert robot.time.delay == pytest.approx(0.3e9 - 20 * _MS, abs=1.5 * _SLACK)


@pytest.mark.parametrize("robot_too", [False, True])
def test_a_motion_waits_for_as_long_as_the_loop_stalled(robot_too):
    """The loop has delayed the motion by what it stalled beyond 18 ms."""
    robot = Robot()
    robot.run(0.5)
    stall = 200 * _MS
    robot.now += stall
    if not robot_too:
        robot.passed += stall
        robot.published = robot.passed
        robot._publish()
    robot.time.delay += stall - 18 * _MS
    moved = [_PERIOD - wait for wait in robot.run(0.1)]
    moved[0] += 18 * _MS
    assert min(moved) >= 0
    assert max(moved) <= 40 * _MS
    assert robot.time.delay == pytest.approx(
        stall if robot_too else stall - 20 * _MS, abs=1.2 * _SLACK
    )


def test_the_robots_time_is_exact_over_a_gap_that_its_motion_does_not_follow():
    robot = Robot()
    robot.run(0.5)
    robot.run(0.3, silent=True)
    before = robot.time.time
    robot.run(_PERIOD / 1e9)
    assert robot.time.time - before == pytest.approx(0.3e9, abs=2 * _PERIOD)
    assert robot.time.delay > 0.2e9


def test_a_motion_follows_a_robot_of_25_states_a_second():
    clock = RobotClock(1.0)
    clock.take(SimpleNamespace(tick=0, arrived=0), moving=False)
    clock.begin(0)
    for k in range(1, 200):
        clock.take(SimpleNamespace(tick=40 * k, arrived=40 * k * _MS), moving=False)
        clock.wait(40 * k * _MS)
    assert clock.delay <= _SLACK


def test_a_tick_that_is_full_begins_again():
    time = RobotClock(1.0)
    time.take(SimpleNamespace(tick=2**32 - 10, arrived=0), moving=True)
    time.begin(0)
    time.take(SimpleNamespace(tick=10, arrived=20 * _MS), moving=True)
    assert time.wait(20 * _MS) == 0


def passed(ticks, every, jitter=0.0, seconds=5.0):
    """The robot's time, s, that passes in `seconds`, with these ticks at intervals of `every` s."""
    rng, clock = np.random.default_rng(2), RobotClock(1.0)
    for k in range(round(seconds / every) + 1):
        arrived = (k + jitter * rng.uniform(-0.5, 0.5)) * every
        clock.take(SimpleNamespace(tick=ticks(k), arrived=round(1e9 * arrived)), moving=False)
    return clock.time / 1e9


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("every", [0.01, 0.002])
def test_a_tick_that_counts_messages_is_no_clock(every, jitter):
    """As in unitree_sim_isaaclab, at 100 Hz and at 500 Hz."""
    assert passed(lambda k: k, every, jitter) == pytest.approx(5.0, abs=0.02)


@pytest.mark.parametrize(
    ("ticks", "every", "pace"),
    [
        (lambda k: 2 * k, 0.002, 1.0),  # ours, and Unitree's C++ simulator
        (lambda k: k, 0.001, 1.0),
        (lambda k: 2 * k, 0.004, 0.5),
        (lambda k: 2 * (k // 2), 0.002, 0.5),  # a slow simulator repeats its LowState
        (lambda k: int(0.6 * k), 0.002, 0.3),
        (lambda k: 10 * k, 0.01, 1.0),
    ],
)
def test_a_tick_in_ms_is_the_robots_time_at_any_pace(ticks, every, pace):
    assert passed(ticks, every) == pytest.approx(5.0 * pace, abs=0.02)


def reading(time, q, dq):
    joints = (values.astype(np.float32) for values in (q, dq, np.zeros(29)))
    return Reading(*joints, IMU, arrived=round(1e9 * time))


def estimate(
    scale,
    rate=500.0,
    seconds=4.0,
    jitter=0.0,
    noise=0.0,
    amplitude=0.4,
    missing=(),
    stands=False,
    moving=True,
):
    """The estimate after joints have swung in a time that is `scale` times the real one.

    Some readings are `missing`, and the simulator may stand still meanwhile.
    """
    rng = np.random.default_rng(7)
    frequency, start = rng.uniform(2.0, 6.0, 29), rng.uniform(0.0, 6.0, 29)
    estimator, stood = RobotClock(), 0.0
    for k in range(round(seconds * rate)):
        if k in missing:
            stood += stands / rate
            continue
        sampled = k / rate
        phase = frequency * scale * (sampled - stood) + start
        q = amplitude * np.sin(phase) + 1e-2 * noise * rng.normal(size=29)
        dq = amplitude * frequency * np.cos(phase) + noise * rng.normal(size=29)
        received = sampled + jitter * rng.uniform()
        estimator.take(reading(received, q, dq), moving=moving)
    return estimator


@pytest.mark.parametrize(
    ("rate", "scale", "disturbed", "within"),
    [
        (500.0, 0.7, {}, 0.003),
        (200.0, 0.88, {}, 0.003),
        (500.0, 1.04, {}, 0.003),
        (200.0, 0.88, {"jitter": 0.002, "noise": 0.01}, 0.01),
        (200.0, 1.0, {"jitter": 0.002, "noise": 0.01}, 0.01),
    ],
)
def test_a_known_scale_is_found(rate, scale, disturbed, within):
    found = estimate(scale, rate, **disturbed)
    assert found.scale == pytest.approx(scale, abs=within)
    assert disturbed or found.median == pytest.approx(scale, abs=0.01)


def test_it_is_one_while_nothing_moves():
    found = estimate(0.8, amplitude=0.0, noise=0.01)
    assert found.scale == pytest.approx(1.0, abs=0.03)
    assert RobotClock().scale == 1.0
    assert RobotClock().median is None


def test_it_is_measured_only_if_it_is_not_given_and_commands_move_the_joints():
    assert estimate(0.8, moving=False).scale == 1.0
    given = RobotClock(0.9)
    for k in range(200):
        given.take(reading(k / 500, np.sin(np.full(29, k / 50)), np.zeros(29)), moving=True)
    assert (given.scale, given.median) == (0.9, None)


def test_it_is_bounded():
    slow = estimate(0.2)
    assert slow.scale == 0.5
    assert slow.median == pytest.approx(0.2, abs=0.01)
    assert estimate(3.0).scale == 1.05


def test_gaps_are_left_out():
    missing = {k for k in range(2000) if k % 300 < 120}
    assert estimate(0.9, missing=missing).scale == pytest.approx(0.9, abs=0.003)


def test_a_stall_of_a_simulator_counts():
    missing = {k for k in range(2000) if k % 250 < 75}
    assert estimate(1.0, missing=missing, stands=True).scale < 0.85


def test_a_span_with_a_reading_that_is_not_finite_is_left_out():
    found = estimate(0.9)
    before = found.scale
    for k in range(200):
        q = np.full(29, np.nan if k < 100 else 0.0)
        found.take(reading(4.0 + k / 500, q, np.zeros(29)), moving=True)
    assert found.scale == pytest.approx(before, abs=1e-3)
