"""Which samples are known to be missing."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from g1stream.dds.messages import LowState, Reference
from g1stream.dds.topics import LOWCMD, LOWSTATE, REFERENCE
from g1stream.recorder.losses import Counter, Losses, Partners, dropped_datagrams
from g1stream.session.samples import Batch


def batch(message, ticks, writer=1):
    made = Batch()
    for tick in ticks:
        message.tick[()] = tick
        made.data.append(message.tobytes())
        made.writers.append(writer)
        made.publish_times.append(1000 * tick)
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
            both.publish_times += one.publish_times
    losses.look(REFERENCE.name, both)
    assert losses.update({REFERENCE.name: 0}) == {}


def test_dds_and_the_numbers_are_two_witnesses_of_the_same_loss():
    losses = Losses()
    losses.look(LOWSTATE.name, batch(LowState(), [*range(100), *range(105, 150)]))
    assert losses.update({LOWSTATE.name: 3, LOWCMD.name: 2}) == {LOWSTATE.name: 5, LOWCMD.name: 2}
    assert losses.update({LOWSTATE.name: 5, LOWCMD.name: 2}) == {}
    assert losses.update({LOWSTATE.name: 9, LOWCMD.name: 2}) == {LOWSTATE.name: 4}
    assert losses.missing == {LOWSTATE.name: 9, LOWCMD.name: 2}


def test_a_reference_without_its_command_is_a_command_lost():
    partners, second = Partners(), 1_000_000_000
    stamps = [i * 2_000_000 for i in range(1000)]
    partners.add_commands(stamp for stamp in stamps if stamp not in stamps[10:13])
    assert partners.add_references(stamps[:500]) == 0
    assert partners.add_references(stamps[500:]) == 3
    assert partners.add_references([3 * second]) == 0


def test_commands_without_references_are_no_loss_and_do_not_pile_up():
    losses = Losses()
    commands = Batch(publish_times=list(range(0, 10**10, 10**7)))
    losses.look(LOWCMD.name, commands)
    assert losses.update({LOWCMD.name: 0}) == {}
    partners = Partners()
    partners.add_commands(commands.publish_times)
    partners.add_references([10**10])
    assert len(partners._commands) <= 101


def test_the_kernel_counts_what_nobody_fetched():
    before = dropped_datagrams()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        receiver.bind(("127.0.0.1", 0))
        for _ in range(100):
            sender.sendto(bytes(1000), receiver.getsockname())
        assert dropped_datagrams() - before > 50


@pytest.mark.parametrize("on_its_way", [0, 1])
def test_what_waits_at_the_end_is_counted_but_for_the_last_moment(on_its_way):
    partners = Partners()
    stamps = [i * 2_000_000 for i in range(100)]
    partners.add_commands(
        stamp for stamp in stamps[: 100 - on_its_way] if stamp not in stamps[50:53]
    )
    assert partners.add_references(stamps) == 0
    assert partners.finish() == 3
