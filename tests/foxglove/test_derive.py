"""How a fast source is thinned for what is derived from it."""

from __future__ import annotations

import numpy as np
import pytest

from g1stream.foxglove.derive import Every


@pytest.mark.parametrize(("rate", "wanted", "kept"), [(500, 100, 100), (1000, 100, 100)])
def test_a_fast_source_is_thinned_evenly(rate, wanted, kept):
    stamps = 1_700_000_000_000_000_000 + np.arange(rate) * (1_000_000_000 // rate)
    every = Every(wanted)
    picked = np.concatenate([part[every.pick(part)] for part in np.array_split(stamps, 20)])
    assert len(picked) == kept
    assert set(np.diff(picked)) == {1_000_000_000 // wanted}


def test_a_slow_source_passes_whole():
    stamps = np.arange(30) * 33_333_333
    assert len(Every(100).pick(stamps)) == 30


def test_an_empty_batch_picks_nothing():
    every = Every(100)
    assert len(every.pick(np.array([], dtype=np.int64))) == 0
    assert len(every.pick(np.array([5, 6]))) == 1
