"""Which samples are known to be missing."""

from __future__ import annotations

import numpy as np
import pytest

from g1stream.dds.messages import LowState, Reference
from g1stream.dds.topics import LOWCMD, LOWSTATE, REFERENCE
from g1stream.recording.losses import Counter, Losses
from g1stream.recording.receiver import Batch


def batch(message, ticks, writer=1):
    made = Batch()
    for tick in ticks:
        message.tick[()] = tick
        made.data.append(message.tobytes())
        made.writers.append(writer)
    return made


@pytest.mark.parametrize("step", [1, 2, 5])
def test_holes_are_counted_whatever_the_step(step):
    counter = Counter()
    assert counter.count(step * np.arange(100)) == 0
    assert counter.count(step * np.arange(103, 120)) == 3
    assert counter.count(step * np.array([120, 121, 125])) == 3


def test_holes_before_the_step_is_known_are_counted_once_it_is():
    counter = Counter()
    assert counter.count(np.array([0, 2, 8])) == 0
    assert counter.count(np.arange(10, 40, 2)) == 2


def test_a_number_that_stands_still_tells_nothing():
    counter = Counter()
    assert counter.count(np.zeros(100, dtype=np.int64)) == 0
    assert counter.step == 0


def test_a_leap_is_a_publisher_that_began_anew():
    counter = Counter()
    counter.count(np.arange(1_000_000, 1_000_100))
    assert counter.count(np.arange(20)) == 0
    assert counter.count(np.arange(20, 5_000_000, 4_000_000)) == 0


def test_two_writers_on_one_topic_are_not_taken_for_holes():
    losses = Losses()
    both = Batch()
    for tick in range(50):
        for writer, offset in ((1, 0), (2, 7000)):
            one = batch(Reference(), [tick + offset], writer)
            both.data += one.data
            both.writers += one.writers
    losses.look(REFERENCE.name, both)
    assert losses.update({REFERENCE.name: 0}) == {}


def test_dds_and_the_numbers_are_two_witnesses_of_the_same_loss():
    losses = Losses()
    losses.look(LOWSTATE.name, batch(LowState(), [*range(100), *range(105, 150)]))
    assert losses.update({LOWSTATE.name: 3, LOWCMD.name: 2}) == {LOWSTATE.name: 5, LOWCMD.name: 2}
    assert losses.update({LOWSTATE.name: 5, LOWCMD.name: 2}) == {}
    assert losses.update({LOWSTATE.name: 9, LOWCMD.name: 2}) == {LOWSTATE.name: 4}
    assert losses.missing == {LOWSTATE.name: 9, LOWCMD.name: 2}
