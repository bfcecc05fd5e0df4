"""Over real DDS: no LowState goes uncounted, and what the guard process sends is sent."""

import time

import pytest

from g1stream.control.guard import Heartbeat, Takeover
from g1stream.control.link import DdsLink
from g1stream.control.receiver import Receiver
from g1stream.dds.discovery import IDLE, AnnouncedBridge
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, POLICY, LowCmd, LowState, PolicyStep, Reference

MOTORS = Receiver(2_000_000, 0.5)


@pytest.fixture
def ends(domain_id, until, request):
    """Our link, and a writer of LowState in a participant of its own, by default our bridge's."""
    user_data = getattr(request, "param", AnnouncedBridge("bolted").user_data)
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as theirs:
        link = DdsLink(ours, None, MOTORS)
        writer = RawWriter(theirs, LOWSTATE, depth=100, user_data=user_data)
        until(lambda: writer.matched, "a match")
        yield link, writer


def publish(writer, ticks):
    state = LowState()
    for tick in ticks:
        state.tick[()] = tick
        writer.write(state.seal())


def test_all_are_counted_and_a_gap_in_the_ticks_is_told(ends, until):
    link, writer = ends
    state = LowState()
    for ticks, received, lost in ((range(2, 42, 2), 20, 0), ([42, 44, 52, 54], 24, 3)):
        publish(writer, ticks)
        until(
            lambda end=ticks[-1]: link.receive(state) and int(state.tick) == end, "the last state"
        )
        counts = link.counts()
        assert (counts["states_received"], counts["states_lost"]) == (received, lost)
    assert counts["states_malformed"] == counts["state_restarts"] == 0


@pytest.mark.parametrize("ends", [b""], indirect=True)
def test_the_ticks_of_another_publisher_show_no_loss(ends, until):
    link, writer = ends
    state = LowState()
    publish(writer, [2, 4, 4, 6, 14, 16])
    until(lambda: link.receive(state) and int(state.tick) == 16, "the last state")
    counts = link.counts()
    assert (counts["states_lost"], counts["dds_lost"], counts["tick_jumps"]) == (None, 0, 1)


STIFF = LowCmd()
STIFF.motor_mode, STIFF.kp[:], STIFF.kd[:] = 1, 100.0, 2.0
STIFF, DAMPING = STIFF.seal(), next(MOTORS.end(STIFF))


@pytest.fixture
def guarded(domain_id, until):
    """A link whose guard may take over, its heartbeat, and the commands that arrive."""
    heartbeat = Heartbeat()
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as theirs:
        link = DdsLink(ours, heartbeat, MOTORS)
        reader = RawReader(theirs, LOWCMD, depth=10)
        until(link.subscribers, "a match")
        arrived = []

        def commands(number):
            until(lambda: arrived.extend(reader.take()) or len(arrived) >= number, "commands")
            return [one.data for one in arrived]

        yield link, heartbeat, commands
    heartbeat.close()


def test_nothing_is_sent_after_the_guard_has_taken_over(guarded):
    link, heartbeat, commands = guarded
    assert link.send(STIFF, Reference().tobytes(), 1) > 0
    written = heartbeat.last_write
    heartbeat.takeover = Takeover.SILENT
    assert link.send(DAMPING, Reference().tobytes(), 1) == 0
    assert heartbeat.command == STIFF  # from which the guard goes on
    heartbeat.takeover = Takeover.NONE
    assert link.send(DAMPING, Reference().tobytes(), 1) > written
    assert commands(2) == [STIFF, DAMPING]


def test_a_write_is_in_progress_until_the_command_is_written(guarded, monkeypatch):
    link, heartbeat, commands = guarded
    write, writing = RawWriter.write, []

    def observed(writer, data, *more):
        writing.append(heartbeat.writing)
        return write(writer, data, *more)

    monkeypatch.setattr(RawWriter, "write", observed)
    link.send(STIFF, Reference().tobytes(), 1)
    assert commands(1) == [STIFF]
    assert writing == [True, False]  # the last is the reference


def test_a_state_has_its_publish_time_and_when_it_was_received(ends, until):
    link, writer = ends
    state, message = LowState(), LowState()
    assert (state.published, state.received) == (0, 0)
    before = time.time_ns()
    writer.write(message.seal(), before - 5_000_000)
    until(lambda: link.receive(state), "a state")
    assert state.published == before - 5_000_000
    assert before < state.received <= time.time_ns()


def test_what_a_source_tells_is_published_with_the_time_of_the_command(domain_id, until):
    steps = [PolicyStep() for _ in range(3)]
    for i, step in enumerate(steps):
        step.step[()], step.observation[1023] = i, i
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as theirs:
        link, reader = DdsLink(ours, None, MOTORS, steps=True), RawReader(theirs, POLICY, depth=10)
        until(lambda: reader.matched, "a match")
        for i, step in enumerate(steps):
            link.send_step(step.tobytes(), 1000 + i // 2)
        arrived = []
        until(lambda: arrived.extend(reader.take()) or len(arrived) == 3, "all steps")
    assert [one.data for one in arrived] == [step.tobytes() for step in steps]
    assert [one.publish_time for one in arrived] == [1000, 1000, 1001]


def test_publishers_of_low_state_by_turns_are_several_and_a_restarted_one_is_not(
    domain_id, until, monkeypatch
):
    state = LowState()
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as theirs:
        before = time.monotonic()
        link = DdsLink(ours, None, MOTORS)
        after = time.monotonic()
        first, second = (RawWriter(theirs, LOWSTATE, depth=10) for _ in range(2))
        subscriber = RawReader(theirs, LOWCMD)
        until(lambda: first.matched and second.matched and link.subscribers(), "all to match")
        for later, waits in ((before + 1.99, True), (after + 2.01, False)):
            with monkeypatch.context() as patch:
                patch.setattr(time, "monotonic", lambda later=later: later)
                assert ("several publishers" in link.unready()) == waits

        subscriber.close()

        def heard(writer, tick):
            publish(writer, [tick])
            until(lambda: link.receive(state) and int(state.tick) == tick, "a state")
            return bool(link.state_publishers())

        assert [heard(first, 2), heard(second, 4), heard(second, 6)] == [False, False, False]
        assert heard(first, 8)


def test_what_announces_to_be_idle_and_publishes_is_another_publisher(domain_id, until):
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as theirs:
        link = DdsLink(ours, None, MOTORS)
        writer = RawWriter(theirs, LOWCMD, user_data=IDLE)
        until(lambda: writer.matched, "a match")
        until(lambda: ours.writers(LOWCMD.name), "its discovery")
        assert link.other_publishers() == []
        writer.write(STIFF)
        until(link.other_publishers, "another publisher")


def test_a_publisher_that_is_matched_before_it_is_announced(domain_id, until, monkeypatch):
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as theirs:
        link, writer = DdsLink(ours, None, MOTORS), RawWriter(theirs, LOWCMD)
        with monkeypatch.context() as patch:
            patch.setattr(ours, "writers", lambda topic: [])
            until(link.other_publishers, "a match")
            assert link.other_publishers() == ["an unnamed participant"]
        until(lambda: "pid" in str(link.other_publishers()), "its name")
        monkeypatch.setattr(ours, "writers", None)  # to ask takes a fraction of a tick
        assert len(link.other_publishers()) == writer.matched == 1
