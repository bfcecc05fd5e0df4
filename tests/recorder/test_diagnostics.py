import os
import socket

import numpy as np
import pytest

from g1stream.dds.messages import COMMANDS, LOWCMD, LOWSTATE, REFERENCE, Batch, LowState, Reference
from g1stream.recorder.diagnostics import (
    ClockReading,
    Losses,
    MissingCommands,
    StepDetector,
    dropped_datagrams,
)
from g1stream.session.records import ClockStep


def batch(message, ticks):
    made = Batch()
    for tick in ticks:
        message.tick[()] = tick
        made.data.append(message.tobytes())
        made.writers.append(1)
        made.publish_times.append(1000 * tick)
    return made


def test_two_writers_on_one_topic_are_counted_apart():
    losses = Losses()
    both = batch(Reference(), [tick for i in range(50) for tick in (i, i + 7000)])
    both.writers = [1, 2] * 50
    losses.add(REFERENCE.name, both)
    assert losses.update({REFERENCE.name: 0}, state_step=2.0) == {}


def test_losses_known_to_dds_and_to_the_ticks_are_not_added_up():
    losses = Losses()
    losses.add(LOWSTATE.name, batch(LowState(), [*range(100), *range(105, 150)]))
    assert losses.update({LOWSTATE.name: 3, LOWCMD.name: 2}, state_step=1.0) == {
        LOWSTATE.name: 5,
        LOWCMD.name: 2,
    }
    assert losses.update({LOWSTATE.name: 5, LOWCMD.name: 2}, state_step=1.0) == {}
    assert losses.update({LOWSTATE.name: 9, LOWCMD.name: 2}, state_step=1.0) == {LOWSTATE.name: 4}
    assert losses.lost == {LOWSTATE.name: 9, LOWCMD.name: 2}


def test_ticks_of_another_bridge_are_no_loss():
    losses = Losses()
    losses.add(LOWSTATE.name, batch(LowState(), [*range(100), *range(105, 150)]))
    assert losses.update({LOWSTATE.name: 0}, state_step=None) == {}
    assert losses.update({LOWSTATE.name: 2}, state_step=None) == {LOWSTATE.name: 2}


def test_a_writer_of_few_samples_has_no_losses_yet():
    losses = Losses()
    losses.add(LOWSTATE.name, batch(LowState(), range(0, 100, 10)))
    assert losses.update({LOWSTATE.name: 0}, state_step=1.0) == {}
    losses.add(LOWSTATE.name, batch(LowState(), [100]))
    assert losses.update({LOWSTATE.name: 0}, state_step=1.0) == {LOWSTATE.name: 90}


def test_commands_without_references_are_no_loss_and_are_not_kept_for_ever():
    losses, step = Losses(), 10_000_000
    for start in range(0, 10**10, 10 * step):
        losses.add(LOWCMD.name, Batch(publish_times=list(range(start, start + 10 * step, step))))
        assert losses.update({LOWCMD.name: 0}, state_step=2.0) == {}
        assert len(losses._commands._commands) <= 110


@pytest.mark.parametrize("commands", COMMANDS.values())
def test_a_command_that_only_its_reference_tells_of_is_lost(commands):
    losses, step = Losses(), 2_000_000
    times = [i * step for i in range(1000)]
    arrived = Batch(publish_times=[time for time in times if time not in times[10:13]])
    losses.add(commands.name, arrived)
    references = batch(Reference(), range(1000))
    references.publish_times = times
    losses.add(REFERENCE.name, references)
    lost = {one.name: 0 for one in (*COMMANDS.values(), REFERENCE)}
    assert losses.update(lost, state_step=2.0) == {commands.name: 3}


def test_references_that_are_drained_before_their_commands_are_no_loss():
    """A recorder that was stopped drains some seconds at once, in the order of the topics."""
    losses, step, each = Losses(), 2_000_000, 1000
    lost = {LOWCMD.name: 0, REFERENCE.name: 0}
    for start in range(0, 4 * each, each):
        references = batch(Reference(), range(start, start + each))
        references.publish_times = [tick * step for tick in range(start, start + each)]
        losses.add(REFERENCE.name, references)
        losses.add(LOWCMD.name, Batch(publish_times=references.publish_times))
        assert losses.update(lost, state_step=2.0) == {}
    losses.finish()
    assert losses.update(lost, state_step=2.0) == {}


def test_datagrams_that_the_kernel_discards_are_counted():
    before = dropped_datagrams(os.getpid())
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        receiver.bind(("127.0.0.1", 0))
        for _ in range(100):
            sender.sendto(bytes(1000), receiver.getsockname())
        assert dropped_datagrams(os.getpid()) - before > 50


@pytest.mark.parametrize("in_transit", [0, 1])
def test_references_that_wait_at_the_end_are_counted_except_the_last(in_transit):
    missing = MissingCommands()
    times = [i * 2_000_000 for i in range(100)]
    arrived = [time for time in times[: 100 - in_transit] if time not in times[50:53]]
    missing.add_commands("rt/lowcmd", arrived)
    missing.add_references(times)
    missing.settle()
    assert missing.count == 0
    missing.finish()
    assert missing.count == 3


@pytest.mark.parametrize("ahead", [10_000_000_000, -10_000_000_000, 0])
def test_commands_of_another_program_do_not_hide_those_of_the_references(ahead):
    missing = MissingCommands()
    times = [i * 2_000_000 for i in range(1000)]
    for i in range(0, 1000, 50):
        missing.add_commands("rt/arm_sdk", times[i : i + 50])
        missing.add_commands("rt/lowcmd", [time + ahead + 1 for time in times[i : i + 50]])
        missing.add_references(times[i : i + 50])
        missing.settle()
    missing.finish()
    assert (missing.topic, missing.count) == ("rt/arm_sdk", 0)


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
