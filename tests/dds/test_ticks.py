import pytest

from g1stream.dds.ticks import TickGaps


def counted(ticks):
    gaps = TickGaps()
    for tick in ticks:
        gaps.add(tick)
    return gaps


@pytest.mark.parametrize(
    ("ticks", "missed"),
    [
        ([0, 2, 4, 6, 8], 0),
        ([0, 6, 8, 10, 20], 2 + 4),
        ([2**32 - 4, 2**32 - 2, 0, 2, 6], 1),
        ([0, 2, 4, 4, 6], 0),
        ([0, 2, 4, 6000], 2997),
        ([0, 2, 4, 4_000_000, 4_000_002], 0),
    ],
    ids=["whole", "gaps at both ends", "wraps", "repeated", "long gap", "jump"],
)
@pytest.mark.parametrize("scale", [1, 10])
def test_missed(ticks, missed, scale):
    gaps = counted([scale * tick % 2**32 for tick in ticks])
    assert gaps.missed(2.0 * scale) == missed
    assert gaps.received == len(ticks)


@pytest.mark.parametrize("rate", [60.0, 333.0, 500.0, 700.0, 1000.0])
@pytest.mark.parametrize("lost", [0, 40])
def test_missed_at_any_rate(rate, lost):
    """Ticks are rounded down to ms: at 700 Hz they are 1 or 2 apart without a loss."""
    ticks = [int(1000 * k / rate) for k in range(5000) if not 1000 <= k < 1000 + lost]
    missed = counted(ticks).missed(1000 / rate)
    assert missed <= lost
    assert lost - missed <= (0 if 1000 % rate == 0 else 1)


@pytest.mark.parametrize("ticks", [[], [5], [0, 0, 0, 0]])
def test_unknown_where_nothing_counts(ticks):
    assert counted(ticks).missed(2.0) == 0
    assert counted(ticks).step is None


def test_simulated_time_that_repeats_and_jumps():
    """As the C++ simulator stamps it: twice as many states as steps of 2 ms."""
    gaps = counted([0, 2, 2, 4, 8, 8, 10, 12, 12, 18])
    assert (gaps.step, gaps.jumps) == (2, 2)


def test_a_restart_is_no_gap():
    gaps = counted([1000, 1002, 1004, 0, 2, 4])
    assert (gaps.missed(2.0), gaps.restarts, gaps.step) == (0, 1, 2)
