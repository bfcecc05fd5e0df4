import os
import zlib

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer

from g1stream.errors import RecordingError
from g1stream.session import mcap_reader
from g1stream.session.mcap_reader import McapFile
from written_sessions import stock_reader

T0 = 1_700_000_000_000_000_000
TOPICS = ("/a", "/b", "/never")


def write(path, *, finish=True, n=400, **settings):
    """Messages of two topics, of lengths of their own, in many small chunks."""
    rng = np.random.default_rng(5)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000, **settings)
        writer.start()
        channels = [writer.register_channel(topic, "none", 0) for topic in TOPICS]
        for i in range(n):
            data = rng.bytes(int(rng.integers(0, 90)))
            writer.add_message(channels[i % 3 == 0], T0 + i, data, T0 - 7 * i, i)
        if finish:
            writer.finish()
        else:
            writer.flush()
    return path


def stock(path, topic):
    return [
        (message.log_time, message.publish_time, message.data)
        for _, _, message in stock_reader(path).iter_messages(topics=[topic])
    ]


def ours(file, topic):
    found = []
    for name, messages in file.batches({topic}):
        assert name == topic
        found += zip(
            messages.log_times.tolist(), messages.publish_times.tolist(), messages.data, strict=True
        )
    return found


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
def test_messages_are_those_of_the_stock_reader(tmp_path, compression, index):
    path = write(tmp_path / "f.mcap", compression=compression, index_types=index)
    file = McapFile(path)
    assert file.complete
    for topic in TOPICS:
        assert ours(file, topic) == stock(path, topic)
        assert file.counts[topic] == len(stock(path, topic))


@pytest.mark.slow
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
def test_a_file_cut_anywhere_counts_what_it_yields(tmp_path, index):
    path = write(tmp_path / "f.mcap", index_types=index)
    whole = {topic: stock(path, topic) for topic in TOPICS}
    size = path.stat().st_size
    lengths = []
    for cut in np.linspace(size - 9, 8, 60, dtype=int):
        os.truncate(path, cut)
        file = McapFile(path)
        assert not file.complete
        for topic in TOPICS:
            found = ours(file, topic)
            assert found == whole[topic][: len(found)]
            assert file.counts[topic] == len(found)
        lengths.append(sum(file.counts.values()))
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[-1] == 0
    assert len(set(lengths)) > 8


def write_chunks(path, chunks):
    """Each chunk is a list of topic, number and data."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {topic: writer.register_channel(topic, "none", 0) for topic in TOPICS}
        for chunk in chunks:
            for topic, i, data in chunk:
                writer.add_message(channels[topic], T0 + i, data, T0 + i)
            writer.flush()
        writer.finish()
    return path


def test_messages_stay_in_order_where_chunks_have_different_topics(tmp_path):
    topics = [("/a",), TOPICS[:2], ("/a",), ("/b",), ("/a",), ("/b",), TOPICS[:2], ("/b",), ("/a",)]
    chunks = [[(topic, i, bytes([i])) for topic in within] for i, within in enumerate(topics)]
    found = {"/a": b"", "/b": b""}
    for topic, messages in McapFile(write_chunks(tmp_path / "f.mcap", chunks)).batches(set(found)):
        found[topic] += b"".join(messages.data)
    assert [list(data) for data in found.values()] == [[0, 1, 2, 4, 6, 8], [1, 3, 5, 6, 7]]


@pytest.mark.parametrize("longer", [-10, 1, 1000, 2**62])
def test_a_message_that_does_not_fit_into_its_chunk_is_noticed(tmp_path, longer):
    path = tmp_path / "f.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start()
        channel = writer.register_channel("/a", "none", 0)
        writer.add_message(channel, T0, b"data", T0)
        writer.finish()
    content = path.read_bytes()
    at = content.index(b"data") - 30  # the message's length, of its data and 22 bytes
    path.write_bytes(content[:at] + (26 + longer).to_bytes(8, "little") + content[at + 8 :])
    with pytest.raises(RecordingError, match="cannot be decoded"):
        ours(McapFile(path), "/a")


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match="pipe is not a file"):
        McapFile(tmp_path / "pipe")


def layout(path):
    """What a reader makes of a file, or why it makes nothing."""
    try:
        file = McapFile(path)
        messages = {topic: ours(file, topic) for topic in TOPICS}
    except RecordingError as error:
        return error.cause
    return file._chunks, file.counts, file.complete, file.unread, file.types, messages


def without_checksum(path, target):
    """The same file, whose summary is not trusted without its checksum."""
    content = path.read_bytes()
    target.write_bytes(content[:-12] + bytes(4) + content[-8:])
    return target


def flip(path, place, bits):
    content = bytearray(path.read_bytes())
    content[place] ^= bits
    path.write_bytes(content)


def first_entry(path):
    """Where the index of chunks has its first chunk."""
    content = path.read_bytes()
    return content.index(b"\x08", int.from_bytes(content[-28:-20], "little")) + 9


@pytest.mark.parametrize("compression", list(CompressionType))
def test_an_index_tells_the_same_as_the_records_in_fewer_reads(tmp_path, monkeypatch, compression):
    path = write(tmp_path / "f.mcap", compression=compression)
    counts, read_at = [], mcap_reader._read_at
    monkeypatch.setattr(
        mcap_reader, "_read_at", lambda *args: counts.append(args) or read_at(*args)
    )
    found = layout(path)
    indexed = len(counts)
    assert found == layout(without_checksum(path, tmp_path / "g.mcap"))
    assert len(counts) - indexed > indexed + 3 * len(found[0])


@pytest.mark.parametrize("place", [0, 4, 12, 20, 28])
def test_a_chunk_that_begins_otherwise_than_indexed_is_noticed(tmp_path, place):
    """Its opcode, length, or the size of its records; its times are not used."""
    path = write(tmp_path / "f.mcap", compression=CompressionType.NONE)
    whole, start = layout(path), McapFile(path)._chunks[3].record.start
    flip(path, start + place, 0x11)
    if place in {12, 20}:
        assert layout(path) == whole
    else:
        assert f"the record at byte {start} " in layout(path)


def test_a_damaged_index_changes_nothing(tmp_path):
    path = write(tmp_path / "f.mcap")
    whole, entry = layout(path), first_entry(path)
    for place in range(entry, entry + 60, 7):
        flip(path, place, 0x40)
        assert layout(path) == whole
        flip(path, place, 0x40)


def test_what_is_behind_a_chunk_of_a_closed_file_is_not_needed(tmp_path):
    path = write(tmp_path / "f.mcap")
    whole, chunk = layout(path), McapFile(path)._chunks[2]
    flip(path, chunk.record.end + 9, 0x20)  # the channel of its MessageIndex record
    assert layout(path) == whole


@pytest.mark.parametrize("n_in_a_chunk", [1, 20])
def test_arrays_of_batches_that_are_kept_stay_as_they_are(tmp_path, monkeypatch, n_in_a_chunk):
    monkeypatch.setattr(mcap_reader, "_GROUP", 0)  # a batch for each chunk
    sent = np.arange(60 * n_in_a_chunk, dtype="<i8")
    chunks = [[("/a", i, i.tobytes()) for i in part] for part in np.split(sent, 60)]
    path = write_chunks(tmp_path / "f.mcap", chunks)
    data, rows, times = [], [], []  # each the last that refers to the memory of its batch
    for kept, of in (
        (data, lambda messages: messages.data),
        (rows, lambda messages: messages.data.rows()),
        (times, lambda messages: messages.log_times),
    ):
        kept += [of(messages) for _, messages in McapFile(path).batches({"/a"})]
        assert len(kept) == 60
    assert [int.from_bytes(one, "little") for part in data for one in part] == sent.tolist()
    assert np.concatenate(rows).view("<i8")[:, 0].tolist() == sent.tolist()
    assert np.concatenate(times).tolist() == (T0 + sent).tolist()


@pytest.mark.parametrize("place", [0, 16, 36, 46, 56])
def test_an_index_with_a_right_checksum_and_wrong_content_hides_no_message(tmp_path, place):
    """A chunk's time, start, the channels of its MessageIndex records, and their length."""
    path = write(tmp_path / "f.mcap")
    flip(path, first_entry(path) + place, 0x01)
    content = path.read_bytes()
    summary = content[int.from_bytes(content[-28:-20], "little") : -12]
    checksum = zlib.crc32(summary).to_bytes(4, "little")
    path.write_bytes(content[:-12] + checksum + content[-8:])
    slow = McapFile(without_checksum(path, tmp_path / "slow.mcap"))
    wanted = {topic: ours(slow, topic) for topic in TOPICS}
    try:
        found = {topic: ours(McapFile(path), topic) for topic in TOPICS}
    except RecordingError:
        return
    assert found == wanted


@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
def test_a_message_is_found_without_what_comes_before_it(tmp_path, index):
    file = McapFile(write(tmp_path / "f.mcap", index_types=index))
    every = ours(file, "/a")
    for number in (0, 1, 50, len(every) - 1):
        chunk, before = file.place_of("/a", number)
        found = [data for _, messages in file.batches({"/a"}, chunk) for data in messages.data]
        assert found == [data for *_, data in every[before:]]
        assert before <= number
        assert number < before + file._chunks[chunk].counts[1]  # the channel of /a is the first
