from contextlib import nullcontext

import pytest

from g1stream.config import RealtimeConfig
from g1stream.doctor import inspection
from g1stream.doctor.inspection import inspect_host, measure_wakeup_latency, wakeup_latency
from g1stream.network import InterfaceFlags
from g1stream.testing import FakeClock

MS = 1_000_000
PERIOD = 2 * MS


def late_clock(late):
    """A clock that oversleeps the k-th deadline, ns."""
    clock = FakeClock()
    clock.oversleeps = {clock.time + (k + 1) * PERIOD: ns for k, ns in late.items()}
    return clock


@pytest.mark.parametrize(
    ("late", "deadlines", "missed", "worst"),
    [
        ({}, 250, 0, 0),
        ({9: PERIOD - 1}, 250, 0, PERIOD - 1),
        ({9: 7 * MS}, 250, 3, 7 * MS),
        # It counts from the deadline that was slept for; one beyond the last ends the measurement.
        ({9: PERIOD, 21: 3 * PERIOD + 1}, 250, 4, 3 * PERIOD + 1),
        ({9: 10_000 * MS}, 5010, 5000, 10_000 * MS),
    ],
)
def test_latency_and_missed_deadlines_of_a_clock(late, deadlines, missed, worst):
    found = wakeup_latency(late_clock(late), PERIOD, 250)
    assert (found.rate, found.deadlines) == (500.0, deadlines)
    assert (found.missed, found.worst_ns) == (missed, worst)
    assert found.median_ns <= 1000  # to the microsecond


def test_on_this_machine():
    facts = inspect_host(RealtimeConfig(priority=0))
    assert InterfaceFlags.LOOPBACK in next(
        one.flags for one in facts.interfaces if one.name == "lo"
    )
    assert {grant.what for grant in facts.grants} >= {"SCHED_FIFO", "memory", "affinity"}
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
