"""Raw writers and readers over real DDS."""

import time
from types import SimpleNamespace

import pytest
from cyclonedds.core import DDSException

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.messages import LOWCMD, LOWSTATE, TOPICS, LowCmd

STAMP = 1_700_000_000_123_456_789


@pytest.fixture
def two(domain_id):
    """Two participants on a domain of the test's own."""
    with Participant(domain_id, "lo") as one, Participant(domain_id, "lo") as other:
        yield one, other


def sample_of(topic, random_payload, seed=1):
    idl_type = topic.message.idl_type
    whole = CDR_HEADER + random_payload(idl_type, seed).tobytes()
    return whole.ljust(Layout.of(idl_type).sample_size, b"\0")


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


def test_a_burst_of_another_process_arrives_in_order(domain_id, peer_on, until):
    n = 200
    with Participant(domain_id, "lo") as participant, peer_on(domain_id) as peer:
        reader = RawReader(participant, LOWCMD, depth=2 * n)
        until(lambda: reader.matched == 1, "the writer")
        for i in range(n):
            peer.write(LOWCMD.name, STAMP + i, numbered(i))
        taken = []
        until(lambda: taken.extend(reader.take()) or len(taken) >= n, "the burst")
        assert [s.publish_time for s in taken] == [STAMP + i for i in range(n)]
        assert [s.data for s in taken] == [numbered(i) for i in range(n)]
        assert reader.take() == []


@pytest.mark.parametrize("topic", TOPICS, ids=lambda t: t.name)
def test_samples_of_this_process_arrive_unaltered(two, topic, random_payload):
    one, other = two
    writer, reader = RawWriter(one, topic), RawReader(other, topic)
    data = sample_of(topic, random_payload)
    assert writer.write(data, STAMP)
    (sample,) = reader.take()
    assert (sample.data, sample.publish_time) == (data, STAMP)


def test_publish_time_is_now_unless_given(two):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD)
    before = time.time_ns()
    writer.write(numbered(1))
    after = time.time_ns()
    (sample,) = reader.take()
    assert before <= sample.publish_time <= after


def test_take_gives_the_oldest_first_and_each_once(two):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD, depth=10)
    for i in range(6):
        writer.write(numbered(i))
    assert [s.data for s in reader.take(4)] == [numbered(i) for i in range(4)]
    assert [s.data for s in reader.take(4)] == [numbered(4), numbered(5)]
    assert reader.take() == []


def test_beyond_its_depth_a_reader_keeps_the_newest(two):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD, depth=3)
    for i in range(8):
        writer.write(numbered(i))
    assert [s.data for s in reader.take()] == [numbered(i) for i in (5, 6, 7)]


def test_take_latest(two):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD, depth=10)
    assert reader.take_latest() is None
    for i in range(3):
        writer.write(numbered(i))
    latest = reader.take_latest()
    assert latest is not None
    assert latest.data == numbered(2)
    assert reader.take_latest() is None


@pytest.mark.parametrize(
    "malformed", [numbered(1) + b"\0\0\0\0", numbered(1)[:-4]], ids=["too long", "cut"]
)
def test_malformed_samples_are_counted_and_not_delivered(two, malformed, monkeypatch):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD, depth=10)
    sample = writer._type
    # A writer of another type that sends no type information; Cyclone refuses to write some.
    monkeypatch.setattr(
        reader, "entity", SimpleNamespace(take=lambda _: [sample(malformed), sample(numbered(2))])
    )
    assert [s.data for s in reader.take()] == [numbered(2)]
    assert reader.malformed == 1


def test_a_sample_too_long_on_the_wire_is_not_delivered(two):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD, depth=10)
    writer.write(numbered(1) + bytes(8))
    writer.write(numbered(2))
    assert [s.data for s in reader.take()] == [numbered(2)]
    assert reader.malformed == 1


@pytest.mark.parametrize("encoding", [b"\x00\x00", b"\x00\x07", b"\x00\x03"])
def test_other_encodings_are_malformed(two, encoding, monkeypatch):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD)
    sample = writer._type(encoding + numbered(1)[2:])
    monkeypatch.setattr(reader, "entity", SimpleNamespace(take=lambda _: [sample]))
    assert reader.take() == []
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


def test_topics_do_not_mix(two):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWSTATE)
    writer.write(numbered(1))
    assert writer.matched == reader.matched == 0
    assert reader.take() == []


def test_a_departing_writer_leaves_no_sample(two, until):
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD, depth=10)
    writer.write(numbered(1))
    writer.close()
    until(lambda: reader.matched == 0, "the departure")
    assert [s.data for s in reader.take()] == [numbered(1)]
    assert reader.take() == []
    assert (reader.malformed, reader.lost) == (0, 0)


def test_a_departing_process_is_noticed(domain_id, peer_on, until):
    with Participant(domain_id, "lo") as participant:
        reader, writer = RawReader(participant, LOWCMD), RawWriter(participant, LOWCMD)
        with peer_on(domain_id):
            until(lambda: reader.matched == 2, "the process's writer, beside ours")
            until(lambda: writer.matched == 2, "the process's reader, beside ours")
        until(lambda: reader.matched == writer.matched == 1, "its departure")


def test_own_writers_can_be_left_out(two, until):
    one, other = two
    reader = RawReader(one, LOWCMD, depth=10, ignore_own=True)
    own, others = RawWriter(one, LOWCMD), RawWriter(other, LOWCMD)
    until(lambda: reader.matched == 1, "the other's writer")
    own.write(numbered(1))
    others.write(numbered(2))
    assert [s.data for s in reader.take()] == [numbered(2)]


def test_what_cannot_be_written_at_once_is_dropped_and_counted(two, monkeypatch):
    writer = RawWriter(two[0], LOWCMD)

    def busy(*_):
        raise DDSException(DDSException.DDS_RETCODE_TIMEOUT)

    monkeypatch.setattr(writer, "_writer", SimpleNamespace(write=busy))
    assert not writer.write(numbered(1))
    assert not writer.write(numbered(1), STAMP)
    assert writer.dropped == 2


def test_other_failures_of_writing_are_raised(two, monkeypatch):
    writer = RawWriter(two[0], LOWCMD)

    def broken(*_):
        raise DDSException(DDSException.DDS_RETCODE_OUT_OF_RESOURCES)

    monkeypatch.setattr(writer, "_writer", SimpleNamespace(write=broken))
    with pytest.raises(DDSException):
        writer.write(numbered(1))
    assert writer.dropped == 0


def test_a_writer_is_never_held_up_by_a_reader_that_does_not_read(two):
    """The reader is not read from; 5,000 samples go out and the newest wait."""
    one, other = two
    writer, reader = RawWriter(one, LOWCMD), RawReader(other, LOWCMD, depth=5)
    assert all(writer.write(numbered(i)) for i in range(5000))
    assert writer.dropped == 0
    assert [s.data for s in reader.take()] == [numbered(i) for i in range(4995, 5000)]
