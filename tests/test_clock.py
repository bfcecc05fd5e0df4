import time
from itertools import islice
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from g1stream import clock as clock_module
from g1stream.clock import SystemClock, Ticker
from g1stream.testing import FakeClock

MS = 1_000_000
PERIOD = 2 * MS


def test_a_sleep_never_ends_early():
    clock = SystemClock()
    for _ in range(20):
        deadline = clock.now() + MS // 2
        clock.sleep_until(deadline)
        assert clock.now() >= deadline


def test_a_deadline_that_has_passed_is_not_slept_for(monkeypatch):
    clock = SystemClock()
    monkeypatch.setattr(clock_module.time, "sleep", lambda _: 1 / 0)
    clock.sleep_until(clock.now() - 1)


@pytest.fixture
def machine(monkeypatch):
    """A machine that takes 2 us to look at the time, and `late` ns to wake."""
    machine = SimpleNamespace(time=0, late=0)

    def now():
        machine.time += 2_000
        return machine.time

    def sleep(seconds):
        machine.time += round(seconds * 1e9) + machine.late

    monkeypatch.setattr(clock_module.time, "monotonic_ns", now)
    monkeypatch.setattr(clock_module.time, "sleep", sleep)
    return machine


def test_it_asks_to_be_woken_sooner_by_what_waking_takes(machine):
    clock, lateness, machine.late = SystemClock(), [], 60_000
    for k in range(1, 200):
        clock.sleep_until(k * MS)
        lateness.append(clock.now() - k * MS)
    assert lateness[0] > 60_000
    assert max(lateness[-50:]) <= 8_000
    assert min(lateness[-50:]) > 0


def test_one_long_delay_is_not_learned(machine):
    """A stall says nothing about how long waking takes; it must not turn into long waits awake."""
    clock, machine.late = SystemClock(), 50 * MS
    clock.sleep_until(10 * MS)
    assert clock._early <= 100_000 // 16 + 1


def test_stamps_are_the_time_of_day():
    before = time.time_ns()
    assert before <= SystemClock().stamp() <= time.time_ns()


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture
def ticker(clock):
    return Ticker(clock, PERIOD, clock.now())


def deadlines(ticker, *ks):
    return [ticker.start + k * PERIOD for k in ks]


def test_work_and_oversleeping_within_a_period_do_not_add_up(ticker, clock):
    clock.oversleeps = dict.fromkeys(deadlines(ticker, *range(1000)), 70_001)
    came = []
    for k, deadline in islice(ticker, 1000):
        assert k == len(came)
        came.append(clock.time - deadline)
        clock.work(900_000)
    assert came == [0] + [70_001] * 999  # the first deadline has come when it is asked for
    assert ticker.skipped == 0
    assert clock.deadlines == deadlines(ticker, *range(1000))


@pytest.mark.parametrize(
    ("work", "following", "skipped"),
    [
        (2 * PERIOD - 1, 1, 0),
        (2 * PERIOD, 2, 1),
        (7 * PERIOD + 5, 7, 6),
    ],
)
def test_work_beyond_a_whole_period_skips_ticks(ticker, clock, work, following, skipped):
    ticks = iter(ticker)
    next(ticks)
    clock.work(work)
    assert next(ticks) == (following, *deadlines(ticker, following))
    assert ticker.skipped == skipped
    assert next(ticks) == (following + 1, *deadlines(ticker, following + 1))
    assert ticker.skipped == skipped


@given(
    st.lists(st.integers(0, 5 * PERIOD), min_size=1, max_size=50),
    st.lists(st.integers(0, 5 * PERIOD), min_size=1, max_size=50),
)
def test_never_early_never_a_period_late_never_a_burst(works, oversleeps):
    class Clock:
        time = 123

        def now(self):
            return self.time

        def sleep_until(self, deadline):
            if deadline > self.time:
                self.time = deadline + oversleeps.pop() if oversleeps else deadline

    clock = Clock()
    ticker = Ticker(clock, PERIOD, clock.now())
    ks = []
    for (k, deadline), work in zip(ticker, works, strict=False):
        assert deadline == ticker.start + k * PERIOD
        assert 0 <= clock.time - deadline < PERIOD
        ks.append(k)
        clock.time += work
    assert len(set(ks)) == len(ks)
    assert ks == sorted(ks)


def test_start_in_the_future_is_waited_for(clock):
    ticker = Ticker(clock, PERIOD, clock.now() + 12_345)
    assert next(iter(ticker)) == (0, ticker.start)
    assert clock.time == ticker.start
