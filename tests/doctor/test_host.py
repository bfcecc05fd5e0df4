"""The wake-up latency, measured on a clock of known lateness."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from g1stream.config import RealtimeConfig
from g1stream.doctor import inspection
from g1stream.doctor.inspection import inspect_host, measure_wakeup_latency, wakeup_latency
from g1stream.testing import FakeClock

MS = 1_000_000
PERIOD = 2 * MS


def late_clock(late=None):
    """A clock that oversleeps the k-th deadline, ns."""
    clock = FakeClock()
    clock.oversleeps = {clock.time + (k + 1) * PERIOD: ns for k, ns in (late or {}).items()}
    return clock


def test_a_clock_without_latency():
    found = wakeup_latency(late_clock(), PERIOD, 250)
    assert (found.rate, found.deadlines, found.missed, found.worst_ns) == (500.0, 250, 0, 0)


def test_latency_below_a_period_misses_no_deadline():
    found = wakeup_latency(late_clock({9: PERIOD - 1}), PERIOD, 250)
    assert (found.missed, found.worst_ns) == (0, PERIOD - 1)
    assert found.median_ns <= 1000  # to the microsecond


def test_a_stall_misses_every_deadline_in_it():
    found = wakeup_latency(late_clock({9: 7 * MS}), PERIOD, 250)
    assert (found.deadlines, found.missed, found.worst_ns) == (250, 3, 7 * MS)


def test_latency_of_a_stall_counts_from_the_deadline_slept_for():
    found = wakeup_latency(late_clock({9: PERIOD, 21: 3 * PERIOD + 1}), PERIOD, 250)
    assert (found.missed, found.worst_ns) == (4, 3 * PERIOD + 1)


def test_a_stall_beyond_the_last_deadline_ends_the_measurement():
    found = wakeup_latency(late_clock({9: 10_000 * MS}), PERIOD, 250)
    assert found.deadlines == 5010
    assert found.missed == 5000


def test_this_machine():
    facts = inspect_host(RealtimeConfig(priority=0))
    assert next(one for one in facts.interfaces if one.name == "lo").loopback
    assert {grant.what for grant in facts.grants} >= {"SCHED_FIFO", "memory", "affinity"}


def test_measured_on_this_machine():
    found = measure_wakeup_latency(RealtimeConfig(priority=0), 500.0, seconds=0.05)
    assert found.deadlines >= 25
    assert found.worst_ns >= found.median_ns


@pytest.mark.parametrize(("loop", "own"), [(50, 49), (1, 0), (0, 0)])
def test_priority_is_below_that_of_a_loop(monkeypatch, loop, own):
    requested = []

    def on_time(*rights):
        requested.append(rights)
        return nullcontext()

    monkeypatch.setattr(inspection, "on_time", on_time)
    measure_wakeup_latency(RealtimeConfig(priority=loop, cpu=3), 500.0, seconds=0.01)
    assert requested == [(own, 3)]
