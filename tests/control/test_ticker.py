"""Deadlines to the nanosecond on a clock of the test's own, and lateness against the raw values."""

import math
import time
from fractions import Fraction
from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from g1stream.clock import SystemClock
from g1stream.control.ticker import Lateness, Ticker

PERIOD = 2_000_000


@pytest.fixture
def ticker(clock):
    return Ticker(clock, PERIOD, clock.now())


def deadlines(ticker, *ks):
    return [ticker.start + k * PERIOD for k in ks]


def test_ticks_are_absolute(ticker, clock):
    assert list(islice(ticker, 4)) == list(enumerate(deadlines(ticker, 0, 1, 2, 3)))
    assert clock.deadlines == deadlines(ticker, 0, 1, 2, 3)
    assert clock.time == ticker.start + 3 * PERIOD
    assert ticker.skipped == 0


def test_work_and_oversleeping_within_a_period_do_not_add_up(ticker, clock):
    clock.oversleeps = dict.fromkeys(deadlines(ticker, *range(1000)), 70_001)
    came = []
    for _, deadline in islice(ticker, 1000):
        came.append(clock.time - deadline)
        clock.work(900_000)
    assert came == [0] + [70_001] * 999  # the first deadline has come when it is asked for
    assert ticker.skipped == 0
    assert clock.deadlines == deadlines(ticker, *range(1000))


@pytest.mark.parametrize(
    ("work", "following", "skipped"),
    [
        (PERIOD, 1, 0),
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


@pytest.mark.parametrize(
    ("oversleep", "came", "skipped"),
    [(PERIOD - 1, 3, 0), (PERIOD, 4, 1), (5 * PERIOD + PERIOD // 2, 8, 5)],
)
def test_a_sleep_that_takes_too_long_skips_ticks(ticker, clock, oversleep, came, skipped):
    (late,) = deadlines(ticker, 3)
    clock.oversleeps[late] = oversleep
    ks = [k for k, _ in islice(ticker, 6)]
    assert ks == [0, 1, 2, came, came + 1, came + 2]
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


def lateness_of(values):
    lateness = Lateness()
    for value in values:
        lateness.add(int(value))
    return lateness


@pytest.mark.parametrize("percent", [0, 1, 50, 90, 99, 99.9, 100])
@pytest.mark.parametrize("n", [1, 2, 10, 999, 1000, 5000])
def test_percentiles_are_those_of_the_raw_values(n, percent):
    values = np.random.default_rng(n).gamma(2.0, 60_000.0, n).astype(int)
    rank = max(1, math.ceil(n * Fraction(str(percent)) / 100))
    truth = np.partition(values, rank - 1)[rank - 1] / 1000.0
    assert truth <= lateness_of(values).percentile_us(percent) <= truth + 1.0


@given(
    st.lists(st.integers(0, 40_000_000), min_size=1, max_size=300),
    st.sampled_from([1, 25, 50, 75, 95, 99, 100]),
)
def test_percentile_is_a_bound_that_so_many_ticks_keep(values, percent):
    bound = lateness_of(values).percentile_us(percent)
    kept = sum(value / 1000.0 <= bound for value in values)
    assert kept * 100 >= len(values) * percent


def test_percentiles_beyond_the_histogram_are_the_maximum():
    lateness = lateness_of([1_000] * 90 + [5_000_000_000] * 10)
    assert lateness.percentile_us(90) == 2.0
    assert lateness.percentile_us(99) == 5_000_000.0


def test_last_bin_and_the_one_before_it():
    assert lateness_of([19_999_999, 30_000_000]).percentile_us(50) == 20_000.0
    assert lateness_of([20_000_000, 30_000_000]).percentile_us(50) == 30_000.0


def test_a_percentile_never_exceeds_the_maximum():
    assert lateness_of([1_500]).percentile_us(50) == 1.5


def test_no_ticks_no_percentile():
    assert np.isnan(Lateness().percentile_us(50))


def test_histogram_does_not_grow():
    lateness = Lateness()
    size = lateness.counts.nbytes
    for value in range(0, 10**11, 10**8):
        lateness.add(value)
    assert lateness.counts.nbytes == size
    assert lateness.n == lateness.counts.sum() == 1000
    assert lateness.maximum_ns == 99_900_000_000


def test_sparse_holds_what_was_counted():
    lateness = lateness_of([0, 999, 1_000, 7_500, 7_999, 25_000_000])
    assert lateness.sparse() == {0: 2, 1: 1, 7: 2, 20000: 1}


def test_system_clock_sleeps_until_and_not_less():
    clock = SystemClock()
    for ahead in (-1_000_000, 0, 300_000, 2_000_000):
        deadline = clock.now() + ahead
        clock.sleep_until(deadline)
        assert clock.now() >= deadline


def test_system_clock_stamps_with_the_time_of_day():
    before = time.time_ns()
    assert before <= SystemClock().stamp() <= time.time_ns()
