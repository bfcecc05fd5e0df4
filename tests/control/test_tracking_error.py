"""The tracking error of a run, state by state, against that of its recording as a whole."""

import numpy as np
import pytest

from g1stream.analysis.tracking import errors_of_run, tracking
from g1stream.app.session import Session
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.targets import Setpoint
from g1stream.control.tracking_error import ErrorSums, RunningError
from g1stream.session.source import MemorySource
from g1stream.testing import SyntheticSession
from g1stream.types import Phase

NOTHING = np.zeros(29)
TARGET = Setpoint(0.0, *[NOTHING] * 10)
IMU = ImuReading(np.zeros(4), np.zeros(3), np.zeros(3))
EVERY = np.ones(29, bool)


def reading(q, published, received, *, finite=True):
    return Reading(q, NOTHING, NOTHING, IMU, stamps=(published, received), finite=finite)


def run(session):
    """What a loop would have fed of a recorded session, in the order of reception."""
    asked, measured, running = session.reference, session.measured, RunningError()
    events = [(int(time), 0, i) for i, time in enumerate(asked.publish_time)]
    events += [(int(time), 1, i) for i, time in enumerate(measured.log_time)]
    for time, state, i in sorted(events):
        if state:
            running.received(reading(measured.q[i], int(measured.publish_time[i]), time))
        else:
            target = TARGET._replace(q=asked.q[i], motion_time=float(asked.motion_time[i]))
            running.asked(time, target, playing=asked.phase[i] == Phase.PLAY)
    return running


def synthetic(**wrong):
    source = MemorySource("synthetic")
    SyntheticSession(2.0, **wrong).write(source)
    return Session(source)


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"delay": 0.02, "noise": 0.01, "bias": 0.03, "gain": 0.9},
        {"latency": 0.015, "noise": 0.01},  # seven references are published meanwhile
        {"gaps": ((0.5, 0.1),), "noise": 0.01},
    ],
)
def test_it_is_that_of_the_recording(wrong):
    session = synthetic(**wrong)
    running, whole = run(session), tracking(session)
    found = errors_of_run(running, EVERY)
    assert found.sums.n == whole.sums.n
    assert found.duration == pytest.approx(whole.duration)
    for name in ("rmse", "mean", "max_abs", "max_abs_at"):
        np.testing.assert_allclose(getattr(found, name), getattr(whole, name), atol=1e-9)
    assert found.summary().limbs.keys() == whole.summary().limbs.keys()


def test_a_publisher_whose_clock_differs_counts_from_reception():
    """Its states seem late by what they were on their way, and not by the offset."""
    away = run(synthetic(clock_offset=-4.0, latency=0.001, bias=0.02))
    here = run(synthetic(latency=0.0, bias=0.02))
    np.testing.assert_allclose(away.finish().rmse, here.finish().rmse, atol=2e-3)  # rad in 1 ms


def test_states_that_cannot_be_compared():
    running = RunningError()
    assert errors_of_run(running, EVERY) is None
    running.asked(0, TARGET, playing=True)
    running.asked(10, TARGET, playing=True)
    for finite in (True, False, True):  # the last waits for a reference after it
        running.received(reading(NOTHING, 5, 6, finite=finite))
    assert (running.finish().n, running.excluded) == (1, 1)
    running.asked(200_000_000, TARGET, playing=True)  # a gap
    running.received(reading(NOTHING, 90_000_000, 90_000_000))
    running.received(reading(NOTHING, 200_000_001, 200_000_001))
    assert (running.finish().n, running.excluded) == (2, 2)
    assert running.duration == 10


def test_only_play_counts():
    running = RunningError()
    for time, playing in enumerate((False, True, True, False, False)):
        running.asked(10 * time, TARGET, playing=playing)
    for time in (5, 15, 25, 35, 99):
        running.received(reading(NOTHING, time, time))
    assert running.finish().n == 2  # after the first and the second reference of PLAY
    assert running.duration == 20


def test_joints_that_do_not_play_count_in_no_figure():
    running = RunningError()
    running.asked(0, TARGET, playing=True)
    running.asked(10, TARGET, playing=True)
    q = np.zeros(29)
    q[0] = 0.5
    for _ in range(2):
        running.received(reading(q, 5, 5))
    played = EVERY.copy()
    assert errors_of_run(running, played).overall == pytest.approx(0.5 / 29**0.5)
    played[0] = False
    assert errors_of_run(running, played).overall == 0.0


def test_sums_do_not_depend_on_the_parts():
    rng = np.random.default_rng(1)
    error, time = rng.normal(size=(1000, 29)), np.arange(1000.0)
    sums = ErrorSums()
    for start, end in ((0, 1), (1, 300), (300, 1000)):
        sums.add(error[start:end], time[start:end])
    np.testing.assert_allclose(sums.rmse, np.sqrt((error**2).mean(axis=0)))
    np.testing.assert_allclose(sums.mean, error.mean(axis=0))
    np.testing.assert_array_equal(sums.max_abs, np.abs(error).max(axis=0))
    np.testing.assert_array_equal(sums.max_abs_at, time[np.abs(error).argmax(axis=0)])
