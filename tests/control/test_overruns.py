import logging
from itertools import pairwise

import pytest

from g1stream.control.report import Overruns
from g1stream.errors import SafetyError
from g1stream.profiles import PROFILES
from g1stream.types import Phase
from known_robots import thresholds

MS = 1_000_000
PERIOD = 2 * MS
SETTLE = 300 * MS


def tick(clock, n):
    """The deadline of the n-th command."""
    return clock.now() + SETTLE + PERIOD + n * PERIOD


@pytest.fixture
def overruns(caplog):
    """The events of overruns: skipped ticks since the last one, and in total."""
    caplog.set_level(logging.INFO, logger="g1stream")
    return lambda: [record.args for record in caplog.records if "overrun" in record.msg]


@pytest.mark.parametrize(("periods", "level"), [(9, logging.INFO), (10, logging.WARNING)])
def test_an_overrun_that_a_servo_notices_is_a_warning(make_loop, clock, caplog, periods, level):
    """20 ms; short ones do not add up to a warning."""
    caplog.set_level(logging.INFO, logger="g1stream")
    clock.oversleeps[tick(clock, 100)] = 3 * PERIOD
    for n in (120, 140, 200):
        clock.oversleeps[tick(clock, n)] = periods * PERIOD
    make_loop().run()
    levels = [record.levelno for record in caplog.records if "overrun" in record.msg]
    assert levels == [logging.INFO, level]


def test_they_are_logged_at_once_then_later_and_none_is_left_out(make_loop, link, clock, overruns):
    for n in (80, 100, 120, 200):
        clock.oversleeps[tick(clock, n)] = 3 * PERIOD
    seen = []
    link.on_send = lambda _: seen.append(overruns())
    report = make_loop().run()
    assert report.skipped == 12
    assert (seen[80], seen[81]) == ([], [(3, 3)])
    # The run is over within the interval: the rest is logged with the last tick.
    assert overruns() == [(3, 3), (9, 12)]


@pytest.mark.parametrize(("gap", "seconds"), [(19, 10), (20, 1)])
def test_short_ones_are_logged_every_ten_seconds_and_long_ones_every_second(caplog, gap, seconds):
    caplog.set_level(logging.INFO, logger="g1stream")
    overruns, logged = Overruns(PERIOD, *thresholds()), []
    for tenth in range(1, 311):
        overruns.stalled(gap * MS)
        overruns.count(100 * MS * tenth, tenth, Phase.PLAY)
        logged += [tenth / 10.0] * len(caplog.records)
        caplog.clear()
    assert logged[0] == 0.1
    assert [round(b - a, 1) for a, b in pairwise(logged)] == [seconds] * round(30 / seconds)


def test_a_stall_has_a_limit():
    overruns = Overruns(PERIOD, *thresholds(state_timeout=0.1))
    assert overruns.stalled(100 * MS) is None
    assert overruns.stalled(100 * MS + 1).kind == "loop"


@pytest.mark.parametrize(("skips", "gap", "stops"), [(10, 100, False), (11, 90, True)])
def test_missed_ticks_have_a_budget_for_a_second(skips, gap, stops):
    """50 of 500 Hz; what was missed more than a second ago does not count."""
    overruns = Overruns(PERIOD, *thresholds(max_missed_ticks=0.1))
    reasons = []
    for i in range(1, skips + 11):
        overruns.count(i * gap * MS, 5 * i, Phase.PLAY)
        reasons.append(overruns.stop())
    assert any(reasons) == stops
    assert not stops or "missed 55 of 500 ticks" in next(filter(None, reasons)).text


def test_a_loop_that_misses_too_many_ticks_damps(make_loop, link, clock):
    """Each second tick; the first half second of the motion is enough."""
    for n in range(80, 300, 2):
        clock.oversleeps[tick(clock, n)] = PERIOD
    report = make_loop(constants=PROFILES["robot"]).run()
    assert "missed 51 of 500 ticks" in report.stop.text
    link.assert_damped()


def test_another_publisher_late_in_the_wait_is_detected_before_the_first_command(
    make_loop, link, clock
):
    """Even in the last tick of WAIT: while waiting, every tick checks."""
    appears = clock.now() + SETTLE - PERIOD
    loop = make_loop()
    link.other_publishers = lambda: ["policy (pid 4242)"] if clock.now() >= appears else []
    with pytest.raises(SafetyError, match="pid 4242"):
        loop.run()
    assert link.sent == []
    assert loop.state.phase is Phase.DONE
