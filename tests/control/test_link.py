"""One contract for every link: the test's own, in this process, and DDS on the loopback."""

import time
from contextlib import contextmanager

import numpy as np
import pytest

from g1stream.control.link import DdsLink
from g1stream.control.receiver import Receiver
from g1stream.dds.discovery import AnnouncedBridge
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE, LowCmd, LowState, Reference

STAMP = 1_700_000_000_123_456_789


class FakeEnds:
    """Both ends of the link that the tests of the loop use."""

    def __init__(self, link):
        self.link = link
        self.subscribed = link.subscribed
        self.held = link.held
        self.contested = link.contested
        self.publish_state = link.publish_state
        self.now = link._clock.now

    def commands(self):
        return [(sent.command.tobytes(), sent.stamp) for sent in self.link.sent]

    def references(self):
        return [(sent.reference.tobytes(), sent.stamp) for sent in self.link.sent]


class DdsEnds:
    """A DdsLink, and a robot at the far end in a participant of its own."""

    def __init__(self, ours, theirs):
        self._theirs = theirs
        self.link = DdsLink(ours, None, Receiver(2_000_000, 0.5))
        self.now = time.monotonic_ns
        self._states = RawWriter(theirs, LOWSTATE)
        self._readers = {REFERENCE.name: RawReader(theirs, REFERENCE, depth=10)}
        self._arrived = {name: [] for name in (LOWCMD.name, *self._readers)}

    @contextmanager
    def subscribed(self):
        reader = RawReader(self._theirs, LOWCMD, depth=10)
        self._readers[LOWCMD.name] = reader
        yield
        self._taken(LOWCMD)
        del self._readers[LOWCMD.name]
        reader.close()

    @contextmanager
    def contested(self):
        writer = RawWriter(self._theirs, LOWCMD)
        yield "pid"
        writer.close()

    @contextmanager
    def held(self, support):
        data = AnnouncedBridge(support).user_data
        writer = RawWriter(self._theirs, LOWSTATE, user_data=data)
        yield
        writer.close()

    def publish_state(self, data):
        self._states.write(data)

    def _taken(self, topic):
        if topic.name in self._readers:
            self._arrived[topic.name] += self._readers[topic.name].take()
        return self._arrived[topic.name]

    def commands(self):
        return [(sample.data, sample.publish_time) for sample in self._taken(LOWCMD)]

    def references(self):
        return [(sample.data, sample.publish_time) for sample in self._taken(REFERENCE)]


@pytest.fixture(params=["fake", "dds"])
def ends(request):
    """A link and its far end, without subscribers and states."""
    if request.param == "fake":
        yield FakeEnds(request.getfixturevalue("bare_link"))
        return
    domain_id = request.getfixturevalue("domain_id")
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as theirs:
        yield DdsEnds(ours, theirs)


def state_of(tick):
    state = LowState()
    state.tick[()] = tick
    state.q[:] = np.arange(29) / 10
    return state.seal()


def test_an_empty_wire(ends):
    state = LowState()
    assert "no subscriber" in ends.link.unready()
    assert ends.link.other_publishers() == []
    assert ends.link.announced() == (None, None)
    assert not ends.link.receive(state)
    assert state.tobytes() == LowState().tobytes()
    assert ends.link.send(LowCmd().seal(), Reference().tobytes(), STAMP)


def test_a_bridge_says_how_it_holds_the_robot(ends, until):
    with ends.held("hanging"):
        until(lambda: ends.link.announced()[0] == "hanging", "the support")
    until(lambda: ends.link.announced()[0] is None, "the departure of the bridge")


def test_the_newest_state_is_received_once(ends, until):
    state = LowState()
    ends.publish_state(state_of(1))
    until(lambda: ends.link.receive(state), "a LowState")
    assert state.tobytes() == state_of(1)
    for tick in (2, 3, 4):
        ends.publish_state(state_of(tick))
    until(lambda: ends.link.receive(state) and int(state.tick) == 4, "the newest LowState")
    assert not ends.link.receive(state)
    assert state.tobytes() == state_of(4)


def test_command_and_reference_arrive_whole_with_one_stamp(ends, until):
    command, reference = LowCmd(), Reference()
    with ends.subscribed():
        until(lambda: not ends.link.unready(), "a subscriber")
        sent = []
        for i in range(3):
            command.q[:] = i / 7
            reference.q[:] = i / 7
            sent.append((command.seal(), reference.tobytes(), STAMP + i))
            before = ends.now()
            assert before <= ends.link.send(*sent[-1]) <= ends.now()
        until(lambda: len(ends.commands()) == 3, "three commands")
        until(lambda: len(ends.references()) == 3, "three references")
        assert ends.commands() == [(command, stamp) for command, _, stamp in sent]
        assert ends.references() == [(reference, stamp) for _, reference, stamp in sent]
        assert ends.link.other_publishers() == []
    until(ends.link.unready, "the departure of the subscriber")


def test_another_publisher_is_named_while_it_is_there(ends, until):
    with ends.contested() as name:
        until(ends.link.other_publishers, "the other publisher")
        (other,) = ends.link.other_publishers()
        assert name in other
    until(lambda: not ends.link.other_publishers(), "its departure")
