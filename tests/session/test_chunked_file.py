"""The layout of a file, by the stock reader: what it finds, and where it is said to be."""

from __future__ import annotations

import io
import struct

import pytest
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Chunk, Message, MessageIndex, Metadata
from mcap.stream_reader import get_chunk_data_stream

T0 = 1_700_000_000_000_000_000


def found(path, **which):
    with path.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        return [(c.topic, m.log_time - T0, m) for _, c, m in reader.iter_messages(**which)]


def expected(stamps, topics, start, end):
    return sorted(
        (int(time) - T0, topic)
        for topic in topics
        for times in stamps[topic]
        for time in times
        if start <= time - T0 < end
    )


@pytest.mark.parametrize("topics", [["/a"], ["/b"], ["/c"], ["/a", "/c"], ["/a", "/b", "/c"]])
@pytest.mark.parametrize(("start", "end"), [(0, 200), (7, 8), (45, 70), (60, 61), (110, 120)])
def test_it_is_sought_through_by_topic_and_time(written, stamps, topics, start, end):
    read = found(written, topics=topics, starting_at=T0 + start, ending_before=T0 + end)
    assert sorted((time, topic) for topic, time, _ in read) == expected(stamps, topics, start, end)
    assert [time for _, time, _ in read] == sorted(time for _, time, _ in read)
    for topic, time, message in read:
        assert message.data == f"{topic} {time}".encode()
        assert message.publish_time == T0 + time - 3


def summary_of(path):
    with path.open("rb") as file:
        return SeekingReader(file, validate_crcs=True).get_summary()


def record_at(content, place, opcode):
    """The content of the record that is said to begin at a place."""
    kind, length = struct.unpack_from("<BQ", content, place)
    assert kind == opcode
    return ReadDataStream(io.BytesIO(content[place + 9 : place + 9 + length]))


def test_each_chunk_is_where_the_summary_says_and_its_message_indexes_behind_it(written, stamps):
    content, summary = written.read_bytes(), summary_of(written)
    assert len(summary.chunk_indexes) == sum(len(chunks) for chunks in stamps.values())
    for index in summary.chunk_indexes:
        chunk = Chunk.read(record_at(content, index.chunk_start_offset, Opcode.CHUNK))
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        data = stream.read(size)
        behind = index.chunk_start_offset + index.chunk_length
        assert index.compressed_size == len(chunk.data)
        assert index.uncompressed_size == len(data)
        for channel, place in index.message_index_offsets.items():
            assert place == behind
            entries = MessageIndex.read(record_at(content, place, Opcode.MESSAGE_INDEX))
            assert entries.channel_id == channel
            behind += 9 + 2 + 4 + 16 * len(entries.records)
            for time, start in entries.records:
                message = Message.read(
                    record_at(data, start, Opcode.MESSAGE),
                    struct.unpack_from("<Q", data, start + 1)[0],
                )
                assert (message.channel_id, message.log_time) == (channel, time)
        assert behind == index.chunk_start_offset + index.chunk_length + index.message_index_length
        times = [time for time, _ in entries.records]
        assert (index.message_start_time, index.message_end_time) == (min(times), max(times))


def test_the_summary_counts_what_is_there(written, stamps):
    summary = summary_of(written)
    counts = {
        summary.channels[channel].topic: count
        for channel, count in summary.statistics.channel_message_counts.items()
    }
    assert counts == {topic: sum(map(len, chunks)) for topic, chunks in stamps.items()}
    times = [int(time) for chunks in stamps.values() for chunk in chunks for time in chunk]
    statistics = summary.statistics
    assert statistics.message_count == len(times)
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))
    assert statistics.chunk_count == len(summary.chunk_indexes)
    assert (statistics.schema_count, statistics.channel_count) == (1, 4)
    assert (statistics.attachment_count, statistics.metadata_count) == (1, 1)


def test_attachments_and_metadata_are_where_the_summary_says(written):
    content, summary = written.read_bytes(), summary_of(written)
    (attached,) = summary.attachment_indexes
    attachment = Attachment.read(record_at(content, attached.offset, Opcode.ATTACHMENT))
    assert (attachment.name, attachment.data) == ("a.txt", b"attached")
    assert (attached.name, attached.data_size) == ("a.txt", 8)
    (noted,) = summary.metadata_indexes
    metadata = Metadata.read(record_at(content, noted.offset, Opcode.METADATA))
    assert (metadata.name, metadata.metadata) == ("some", {"key": "value"})
    assert attached.offset + attached.length == noted.offset
    assert content[noted.offset + noted.length] == Opcode.DATA_END
