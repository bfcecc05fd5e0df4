import time
from types import SimpleNamespace

import pytest
from cyclonedds.core import DDSException

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import LOWCMD, TOPICS, LowCmd

STAMP = 1_700_000_000_123_456_789


@pytest.fixture
def two(domain_id):
    """Two participants on a domain of the test's own."""
    with Participant(domain_id, "lo") as one, Participant(domain_id, "lo") as other:
        yield one, other


def sample_of(topic, random_payload, seed):
    whole = CDR_HEADER + random_payload(topic.idl_type, seed).tobytes()
    return whole.ljust(Layout.of(topic.idl_type).sample_size, b"\0")


def numbered(i):
    command = LowCmd()
    command.q[:] = i
    return command.tobytes()


def test_samples_of_another_process_arrive_unaltered(domain_id, peer_on, until, random_payload):
    with Participant(domain_id, "lo") as participant, peer_on(domain_id) as peer:
        for i, topic in enumerate(TOPICS):
            reader = RawReader(participant, topic, depth=10)
            until(lambda reader=reader: reader.matched == 1, f"a writer of {topic.name}")
            data, taken = sample_of(topic, random_payload, i), []
            peer.write(topic.name, STAMP + i, data)
            until(lambda r=reader, t=taken: t.extend(r.take()) or t, f"a {topic.name}")
            assert [(s.data, s.publish_time) for s in taken] == [(data, STAMP + i)]
            assert (reader.malformed, reader.lost) == (0, 0)


def test_take_gives_the_oldest_first_and_each_once(two):
    writer, reader = RawWriter(two[0], LOWCMD), RawReader(two[1], LOWCMD, depth=10)
    before = time.time_ns()
    for i in range(6):
        writer.write(numbered(i))
    taken = reader.take(4)
    assert [s.data for s in taken] == [numbered(i) for i in range(4)]
    assert before <= taken[0].publish_time <= taken[3].publish_time <= time.time_ns()
    assert [s.data for s in reader.take(4)] == [numbered(4), numbered(5)]
    assert reader.take() == []


def test_take_latest(two):
    writer, reader = RawWriter(two[0], LOWCMD), RawReader(two[1], LOWCMD, depth=10)
    assert reader.take_latest() is None
    for i in range(3):
        writer.write(numbered(i))
    assert reader.take_latest().data == numbered(2)
    assert reader.take_latest() is None


@pytest.mark.parametrize("malformed", [numbered(1)[:-4], b"\x00\x07" + numbered(1)[2:]])
def test_malformed_samples_are_counted_and_not_delivered(two, malformed, monkeypatch):
    writer, reader = RawWriter(two[0], LOWCMD), RawReader(two[1], LOWCMD, depth=10)
    sample = writer._type
    # A writer of another type that sends no type information; Cyclone refuses to write some.
    monkeypatch.setattr(
        reader, "entity", SimpleNamespace(take=lambda _: [sample(malformed), sample(numbered(2))])
    )
    assert [s.data for s in reader.take()] == [numbered(2)]
    assert reader.malformed == 1


def test_a_sample_too_long_on_the_wire_is_not_delivered(two):
    writer, reader = RawWriter(two[0], LOWCMD), RawReader(two[1], LOWCMD, depth=10)
    writer.write(numbered(1) + bytes(8))
    writer.write(numbered(2))
    assert [s.data for s in reader.take()] == [numbered(2)]
    assert reader.malformed == 1


def test_matches_are_counted_at_both_ends(two, until):
    one, other = two
    writer = RawWriter(one, LOWCMD)
    assert writer.matched == 0
    readers = [RawReader(other, LOWCMD), RawReader(one, LOWCMD)]
    until(lambda: writer.matched == 2, "two readers")
    assert [reader.matched for reader in readers] == [1, 1]
    readers[0].close()
    until(lambda: writer.matched == 1, "the departure of one")


def test_a_departing_writer_leaves_no_sample(two, until):
    writer, reader = RawWriter(two[0], LOWCMD), RawReader(two[1], LOWCMD, depth=10)
    writer.write(numbered(1))
    writer.close()
    until(lambda: reader.matched == 0, "the departure")
    assert [s.data for s in reader.take()] == [numbered(1)]
    assert reader.take() == []
    assert (reader.malformed, reader.lost) == (0, 0)


def test_own_writers_can_be_left_out(two, until):
    one, other = two
    reader = RawReader(one, LOWCMD, depth=10, ignore_own=True)
    own, others = RawWriter(one, LOWCMD), RawWriter(other, LOWCMD)
    until(lambda: reader.matched == 1, "the other's writer")
    own.write(numbered(1))
    others.write(numbered(2))
    assert [s.data for s in reader.take()] == [numbered(2)]


def test_what_cannot_be_written_at_once_is_dropped_and_counted(two, monkeypatch):
    writer, code = RawWriter(two[0], LOWCMD), DDSException.DDS_RETCODE_TIMEOUT

    def fail(*_):
        raise DDSException(code)

    monkeypatch.setattr(writer, "_writer", SimpleNamespace(write=fail))
    assert not writer.write(numbered(1))
    assert not writer.write(numbered(1), STAMP)
    assert writer.dropped == 2
    code = DDSException.DDS_RETCODE_OUT_OF_RESOURCES
    with pytest.raises(DDSException):
        writer.write(numbered(1))
    assert writer.dropped == 2


def test_a_writer_is_never_held_up_by_a_reader_that_does_not_read(two):
    writer, reader = RawWriter(two[0], LOWCMD), RawReader(two[1], LOWCMD, depth=5)
    assert all(writer.write(numbered(i)) for i in range(1000))
    assert writer.dropped == 0
    assert [s.data for s in reader.take()] == [numbered(i) for i in range(995, 1000)]
