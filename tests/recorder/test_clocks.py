import numpy as np
import pytest

from g1stream.recorder.diagnostics import ClockReading, StepDetector
from g1stream.session.records import ClockStep

T0 = 1_700_000_000_000_000_000
MS = 1_000_000
S = 1000 * MS


def steps_of(offsets, period=50 * MS):
    detector = StepDetector()
    found = [
        detector.observe(ClockReading(T0 + i * period + offset, i * period))
        for i, offset in enumerate(offsets)
    ]
    return detector, found


def test_no_step_while_the_clocks_keep_their_offset():
    detector, found = steps_of([0] * 100)
    assert not any(found)
    assert (detector.first, detector.last, detector.steps) == (T0, T0, [])


@pytest.mark.parametrize("step", [3600 * S, -3600 * S, 5 * MS, -5 * MS])
def test_a_step_is_detected_once_with_its_size(step):
    detector, found = steps_of([0] * 10 + [step] * 10)
    assert found == [0] * 10 + [step] + [0] * 9
    assert detector.steps == [ClockStep(at_ns=T0 + 10 * 50 * MS + step, step_ns=step)]


def test_slewing_is_no_step_but_changes_the_offset():
    slewed = 500 * np.arange(0, 20_000, 50)  # NTP's most: 500 ppm
    detector, found = steps_of(slewed.tolist())
    assert not any(found)
    assert detector.last - detector.first == slewed[-1]
