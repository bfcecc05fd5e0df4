"""When a session was in which phase."""

import numpy as np
import pytest

from g1stream.analysis.phase_intervals import Span, phase_spans
from g1stream.errors import RecordingError
from g1stream.types import Phase


def test_a_phase_lasts_until_the_next_one_begins():
    times = np.array([10.0, 10.1, 10.2, 10.5, 10.9])
    phases = np.array([Phase.RAMP, Phase.RAMP, Phase.PLAY, Phase.PLAY, Phase.DAMP], np.uint8)
    spans = phase_spans(times, phases)
    assert spans == [
        Span(Phase.RAMP, 10.0, 10.2),
        Span(Phase.PLAY, 10.2, 10.9),
        Span(Phase.DAMP, 10.9, 10.9),
    ]
    assert spans[1].seconds == 10.9 - 10.2


def test_a_number_that_falls_is_a_change_too():
    """Of unsigned numbers, the difference to a smaller one is a large one."""
    spans = phase_spans(np.arange(2.0), np.array([Phase.DAMP, Phase.RAMP], np.uint8))
    assert [span.phase for span in spans] == [Phase.DAMP, Phase.RAMP]


def test_nothing_published():
    assert phase_spans(np.empty(0), np.empty(0, np.uint8)) == []


def test_a_phase_that_is_not_known_is_named():
    with pytest.raises(RecordingError, match="in phase 99, which is none of those known here"):
        phase_spans(np.arange(2.0), np.array([Phase.PLAY, 99], np.uint8))
