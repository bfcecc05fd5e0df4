import math
from fractions import Fraction

import numpy as np
import pytest

from g1stream.control.report import Lateness, LoopReport


def lateness_of(values):
    lateness = Lateness()
    for value in values:
        lateness.add(int(value))
    return lateness


@pytest.mark.parametrize("n", [1, 10, 999, 1000])
def test_percentiles_are_those_of_the_raw_values(n):
    values = np.sort(np.random.default_rng(n).gamma(2.0, 60_000.0, n).astype(int))
    lateness = lateness_of(values)
    for percent in (0, 1, 50, 90, 99, 99.9, 100):
        rank = max(1, math.ceil(n * Fraction(str(percent)) / 100))
        truth = values[rank - 1] / 1000.0
        assert truth <= lateness.percentile_us(percent) <= truth + 1.0


@pytest.mark.parametrize(
    ("values", "percent", "expected"),
    [
        ([1_000] * 90 + [5_000_000_000] * 10, 90, 2.0),
        ([1_000] * 90 + [5_000_000_000] * 10, 99, 5_000_000.0),
        ([19_999_999, 30_000_000], 50, 20_000.0),
        ([20_000_000, 30_000_000], 50, 30_000.0),  # the last bin
        ([1_500], 50, 1.5),  # never beyond the maximum
    ],
)
def test_percentiles_at_the_edges(values, percent, expected):
    assert lateness_of(values).percentile_us(percent) == expected


def test_no_ticks_no_percentile():
    assert np.isnan(Lateness().percentile_us(50))


def test_sparse_holds_what_was_counted():
    lateness = lateness_of([0, 999, 1_000, 7_500, 7_999, 25_000_000])
    assert lateness.sparse() == {0: 2, 1: 1, 7: 2, 20000: 1}


def test_a_report_of_one_command_has_no_rate():
    report = LoopReport(2_000_000, *[None] * 4)
    report.commands, report.first_sent, report.last_sent = 1, 5, 5
    assert report.rate is None
