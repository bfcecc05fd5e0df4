"""What a loop that is too late does, counts and tells."""

from itertools import pairwise

from g1stream.types import Phase

MS = 1_000_000
PERIOD = 2 * MS
SETTLE = 300 * MS


def tick(clock, n):
    """The deadline of the n-th command."""
    return clock.now() + SETTLE + PERIOD + n * PERIOD


def told(link):
    return [text for level, text in link.told if level == 3 and "overrun" in text]


def test_no_overrun_is_told_of_where_there_is_none(make_loop, link):
    make_loop().run()
    assert told(link) == []


def test_an_overrun_is_told_at_once(make_loop, link, clock):
    late = tick(clock, 100)
    clock.oversleeps[late] = 5 * PERIOD
    when = []
    tell = link.tell
    link.tell = lambda level, text: (when.append((clock.now(), text)), tell(level, text))
    make_loop().run()
    assert told(link) == ["overrun: ticks skipped: 5, 5 so far"]
    assert (late + 5 * PERIOD, told(link)[0]) in when


def test_more_of_them_are_told_once_a_second_and_none_is_left_out(make_loop, link, clock):
    for n in (80, 100, 120, 200):
        clock.oversleeps[tick(clock, n)] = 3 * PERIOD
    report = make_loop().run()
    assert report.skipped == 12
    # The run is over within the second: the rest is told with the last tick.
    assert told(link) == [
        "overrun: ticks skipped: 3, 3 so far",
        "overrun: ticks skipped: 9, 12 so far",
    ]


def test_late_ticks_are_never_made_up_for_in_a_burst(make_loop, link, clock):
    clock.oversleeps[tick(clock, 100)] = 20 * PERIOD
    make_loop().run()
    times = [sent.time for sent in link.sent]
    assert min(b - a for a, b in pairwise(times)) == PERIOD


def test_a_rival_that_comes_late_in_the_wait_is_seen_before_the_first_command(
    make_loop, link, clock
):
    """Even in the last tick of the wait, long after the last look in a hurry would have been."""
    appears = clock.now() + SETTLE - PERIOD
    loop = make_loop()
    rivals = link.rivals
    link.rivals = lambda: ["policy (pid 4242)"] if clock.now() >= appears else rivals()
    report = loop.run()
    assert link.sent == []
    assert "pid 4242" in report.reason
    assert loop.state.phase is Phase.DONE
