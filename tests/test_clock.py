"""The clock of this machine: what holds of it however busy the machine is."""

from g1stream import clock as clock_module
from g1stream.clock import SystemClock

MS = 1_000_000


def test_a_sleep_never_ends_early():
    clock = SystemClock()
    for _ in range(100):
        deadline = clock.now() + MS // 2
        clock.sleep_until(deadline)
        assert clock.now() >= deadline


def test_a_deadline_that_has_passed_is_not_slept_for(monkeypatch):
    clock = SystemClock()
    monkeypatch.setattr(clock_module.time, "sleep", lambda _: 1 / 0)
    clock.sleep_until(clock.now() - 1)


def test_it_asks_to_be_woken_sooner_by_what_waking_takes(monkeypatch):
    """On a machine of the test's own, that takes 60 us to wake, and 2 us to look at the time."""
    time, asked = 0, []

    def now():
        nonlocal time
        time += 2_000
        return time

    def sleep(seconds):
        nonlocal time
        asked.append(time + round(seconds * 1e9))
        time = asked[-1] + 60_000

    clock = SystemClock()
    monkeypatch.setattr(clock_module.time, "monotonic_ns", now)
    monkeypatch.setattr(clock_module.time, "sleep", sleep)
    lateness = []
    for k in range(1, 200):
        clock.sleep_until(k * MS)
        lateness.append(now() - k * MS)
    assert lateness[0] > 60_000
    assert max(lateness[-50:]) <= 8_000
    assert min(lateness[-50:]) > 0


def test_one_long_delay_is_not_learned(monkeypatch):
    """A stall says nothing about how long waking takes; it must not turn into long waits awake."""
    time = 0

    def now():
        return time

    def sleep(seconds):
        nonlocal time
        time += round(seconds * 1e9) + 50 * MS

    clock = SystemClock()
    monkeypatch.setattr(clock_module.time, "monotonic_ns", now)
    monkeypatch.setattr(clock_module.time, "sleep", sleep)
    clock.sleep_until(10 * MS)
    assert clock._early <= 100_000 // 16 + 1
