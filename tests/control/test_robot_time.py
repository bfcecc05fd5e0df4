from types import SimpleNamespace

import pytest

from g1stream.control.robot_time import RobotTime

_MS = 1_000_000
_PERIOD = 2 * _MS
_SLACK = 10 * _MS


class Robot:
    """Publishes LowState every 2 ms of its time, `pace` times as fast as the clock."""

    def __init__(self, pace=1.0, ticks=True):
        self.time = RobotTime()
        self.now = self.passed = self.published = 0.0
        self.pace, self.ticks = pace, ticks
        self._publish()
        self.time.begin(0)

    def _publish(self):
        tick = round(self.published / _MS) if self.ticks else 0
        self.time.add(SimpleNamespace(tick=tick, received=round(self.now)), self.pace)

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
def test_a_motion_waits_while_the_simulator_stalls_and_catches_up_with_it(ticks):
    robot = Robot(ticks=ticks)
    robot.run(0.5)
    robot.run(0.3, silent=True)
    assert robot.time.delay == pytest.approx(0.3e9 - 2 * _SLACK, abs=_PERIOD)
    # The simulator has gone on meanwhile: its tick leaps by 300 ms. Without a tick, it stood still.
    waits = robot.run(0.1)
    assert (min(waits) == -20 * _MS) == ticks
    stood = 0.0 if ticks else 0.3e9 - 20 * _MS
    assert robot.time.delay == pytest.approx(stood, abs=_SLACK if ticks else 1.5 * _SLACK)


@pytest.mark.parametrize("robot_too", [False, True])
def test_a_loop_that_stalled_catches_up_or_waits_as_the_robot_did(robot_too):
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
    assert robot.time.delay == pytest.approx(stall if robot_too else 0, abs=1.2 * _SLACK)


def test_a_tick_that_is_full_begins_again():
    time = RobotTime()
    time.add(SimpleNamespace(tick=2**32 - 10, received=0), 1.0)
    time.begin(0)
    time.add(SimpleNamespace(tick=10, received=20 * _MS), 1.0)
    assert time.wait(20 * _MS) == 0
