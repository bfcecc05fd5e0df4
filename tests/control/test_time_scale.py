"""The scale of the robot's time, from joints that move as a simulator of known speed moves them."""

import numpy as np
import pytest

from g1stream.control.reading import ImuReading, Reading
from g1stream.control.robot_time import TimeScale

IMU = ImuReading(*(np.zeros(n) for n in (4, 3, 3)))


def reading(time, q, dq):
    joints = (values.astype(np.float32) for values in (q, dq, np.zeros(29)))
    return Reading(*joints, IMU, received=round(1e9 * time))


def estimate(
    scale,
    rate=500.0,
    seconds=4.0,
    jitter=0.0,
    noise=0.0,
    amplitude=0.4,
    missing=(),
    stands=False,
):
    """The estimate after joints have swung in a time that is `scale` times the real one.

    Some readings are `missing`, and the simulator may stand still meanwhile.
    """
    rng = np.random.default_rng(7)
    frequency, start = rng.uniform(2.0, 6.0, 29), rng.uniform(0.0, 6.0, 29)
    estimator, stood = TimeScale(), 0.0
    for k in range(round(seconds * rate)):
        if k in missing:
            stood += stands / rate
            continue
        sampled = k / rate
        phase = frequency * scale * (sampled - stood) + start
        q = amplitude * np.sin(phase) + 1e-2 * noise * rng.normal(size=29)
        dq = amplitude * frequency * np.cos(phase) + noise * rng.normal(size=29)
        received = sampled + jitter * rng.uniform()
        estimator.add(reading(received, q, dq))
    return estimator


@pytest.mark.parametrize(
    ("rate", "scale", "disturbed", "within"),
    [
        (500.0, 0.7, {}, 0.003),
        (200.0, 0.88, {}, 0.003),
        (500.0, 1.04, {}, 0.003),
        (200.0, 0.88, {"jitter": 0.002, "noise": 0.01}, 0.01),
        (200.0, 1.0, {"jitter": 0.002, "noise": 0.01}, 0.01),
    ],
)
def test_a_known_scale_is_found(rate, scale, disturbed, within):
    found = estimate(scale, rate, **disturbed)
    assert found.value == pytest.approx(scale, abs=within)
    assert disturbed or found.median == pytest.approx(scale, abs=0.01)


def test_it_is_one_while_nothing_moves():
    found = estimate(0.8, amplitude=0.0, noise=0.01)
    assert found.value == pytest.approx(1.0, abs=0.03)
    assert TimeScale().value == 1.0
    assert TimeScale().median is None


def test_it_is_bounded():
    slow = estimate(0.2)
    assert slow.value == 0.5
    assert slow.median == pytest.approx(0.2, abs=0.01)
    assert estimate(3.0).value == 1.05


def test_gaps_are_left_out():
    missing = {k for k in range(2000) if k % 300 < 120}
    assert estimate(0.9, missing=missing).value == pytest.approx(0.9, abs=0.003)


def test_a_stall_of_a_simulator_counts():
    missing = {k for k in range(2000) if k % 250 < 75}
    assert estimate(1.0, missing=missing, stands=True).value < 0.85


def test_a_span_with_a_reading_that_is_not_finite_is_left_out():
    found = estimate(0.9)
    before = found.value
    for k in range(200):
        q = np.full(29, np.nan if k < 100 else 0.0)
        found.add(reading(4.0 + k / 500, q, np.zeros(29)))
    assert found.value == pytest.approx(before, abs=1e-3)
