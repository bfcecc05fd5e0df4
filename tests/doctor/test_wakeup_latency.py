"""What a trial of deadlines says, on a clock whose lateness is made up."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from g1stream.config import RealtimeConfig
from g1stream.doctor import wakeup_latency as punctuality
from g1stream.doctor.wakeup_latency import try_waking, wake

MS = 1_000_000
PERIOD = 2 * MS


class LateClock:
    """Comes late to the k-th deadline that it is asked for."""

    def __init__(self, late: dict[int, int]) -> None:
        self.time, self.asked, self.late = 5 * MS, 0, late

    def now(self) -> int:
        return self.time

    def stamp(self) -> int:
        return self.time

    def sleep_until(self, deadline: int) -> None:
        self.time = max(self.time, deadline) + self.late.get(self.asked, 0)
        self.asked += 1


def test_a_clock_that_keeps_its_word():
    found = wake(LateClock({}), PERIOD, 250)
    assert (found.rate, found.deadlines, found.missed, found.worst_ns) == (500.0, 250, 0, 0)


def test_late_by_less_than_a_period_misses_nothing():
    found = wake(LateClock({9: PERIOD - 1}), PERIOD, 250)
    assert (found.missed, found.worst_ns) == (0, PERIOD - 1)
    assert found.usual_ns <= 1000  # to the microsecond


def test_a_stall_misses_every_deadline_in_it():
    found = wake(LateClock({9: 7 * MS}), PERIOD, 250)
    assert (found.deadlines, found.missed, found.worst_ns) == (250, 3, 7 * MS)


def test_the_lateness_of_a_stall_is_that_of_the_deadline_slept_for():
    found = wake(LateClock({9: PERIOD, 20: 3 * PERIOD + 1}), PERIOD, 250)
    assert (found.missed, found.worst_ns) == (4, 3 * PERIOD + 1)


def test_a_stall_to_the_end_ends_the_trial():
    found = wake(LateClock({9: 10_000 * MS}), PERIOD, 250)
    assert found.deadlines == 5010
    assert found.missed == 5000


def test_this_machine_can_be_tried():
    found = try_waking(RealtimeConfig(priority=0), 500.0, seconds=0.05)
    assert found.deadlines >= 25
    assert found.worst_ns >= found.usual_ns


@pytest.mark.parametrize(("loops", "own"), [(50, 49), (1, 0), (0, 0)])
def test_a_loop_that_runs_meanwhile_comes_first(monkeypatch, loops, own):
    asked = []

    def on_time(*rights):
        asked.append(rights)
        return nullcontext()

    monkeypatch.setattr(punctuality, "on_time", on_time)
    try_waking(RealtimeConfig(priority=loops, cpu=3), 500.0, seconds=0.01)
    assert asked == [(own, 3)]
