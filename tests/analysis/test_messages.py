"""Message figures, against intervals and latencies chosen by hand."""

import numpy as np
import pytest

from g1stream.analysis.messages import message_stats
from g1stream.session.streams import Stream

T0 = 1_700_000_000_000_000_000


@pytest.fixture
def stream():
    """Makes a stream from publish times and latencies, ns."""

    def make(published, latency):
        published = T0 + np.asarray(published, dtype=np.int64)
        return Stream(log_time=published + np.asarray(latency), publish_time=published)

    return make


def test_rate_gaps_and_longest_interval(stream):
    intervals = np.full(1000, 2_000_000)
    # One is just no gap, two are.
    intervals[[100, 500, 800]] = 6_000_000, 6_000_001, 45_000_000
    stats = message_stats(stream(np.cumsum([0, *intervals]), 50_000), lost=7)
    assert (stats.count, stats.lost) == (1001, 7)
    assert stats.gaps == 2
    assert stats.longest_interval_s == pytest.approx(0.045)
    assert stats.rate_hz == pytest.approx(1000 / (997 * 0.002 + 0.006 + 0.006000001 + 0.045))


def test_latency_percentiles(stream):
    rng = np.random.default_rng(2)
    stats = message_stats(stream(np.arange(1001) * 2_000_000, 1000 * rng.permutation(1001)))
    # Of 0, 1, ..., 1000 us the percentiles are the numbers themselves.
    assert [*vars(stats.latency_us).values()] == pytest.approx([500.0, 990.0, 999.0, 1000.0])
    assert stats.clock_offset_s == 0.0


def test_a_single_message_has_no_interval(stream):
    stats = message_stats(stream([0], 70_000))
    assert (stats.rate_hz, stats.longest_interval_s, stats.gaps) == (None, None, 0)
    assert stats.latency_us.max == pytest.approx(70.0)


def test_messages_of_one_instant_have_no_rate(stream):
    assert message_stats(stream([5, 5, 5], 1000)).rate_hz is None


@pytest.mark.parametrize("latency", [0, 50_000, 20_000_000])
def test_clocks_that_may_agree_are_left_alone(stream, latency):
    assert stream([0, 1000, 2000], latency).clock_offset == 0


@pytest.mark.parametrize("latency", [-1000, -3_200_000_000, 20_000_001, 7_000_000_000])
def test_clocks_that_differ_are_seen(stream, latency):
    assert stream([0, 1000, 2000], latency).clock_offset == latency


def test_a_clock_set_once_or_a_slow_start_is_no_other_clock(stream):
    latency = np.full(1000, 60_000)
    latency[:20] = 90_000_000
    latency[500] = -5_000_000
    assert stream(np.arange(1000) * 2_000_000, latency).clock_offset == 0


def test_messages_that_overtook_each_other(stream, change):
    straight = stream(np.arange(100) * 2_000_000, 60_000)
    swapped = np.arange(100)
    swapped[[40, 41]] = 41, 40
    mixed = change(
        straight,
        publish_time=straight.publish_time[swapped],
        log_time=straight.log_time[swapped],
    )
    assert message_stats(mixed) == message_stats(straight)
