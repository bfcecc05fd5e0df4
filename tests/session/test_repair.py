import os
import signal
import subprocess
import sys

import pytest
import yaml
from mcap.opcode import Opcode
from mcap.writer import Writer

from g1stream.app.session import open_session
from g1stream.dds.messages import LOWCMD, LOWSTATE
from g1stream.errors import RecordingError
from g1stream.session.mcap_reader import McapFile
from g1stream.session.repair import repair_session
from written_sessions import stock_reader


@pytest.fixture
def sent(make_sample, on_the_wire):
    return {
        f"/{topic.name[3:]}": [on_the_wire(make_sample(topic)) for _ in range(40)]
        for topic in (LOWCMD, LOWSTATE)
    }


def passes_doctor(path):
    """Check a file with pymcap-cli."""
    program = "from sys import exit; from pymcap_cli.cli import main; exit(main())"
    command = [sys.executable, "-c", program, "doctor", str(path)]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stdout
    assert "passed" in result.stdout


def by_stock_reader(path):
    """Topic, log time and data of the messages; names of attachments and metadata, by index."""
    reader = stock_reader(path, validate_crcs=True)
    summary = reader.get_summary()
    found = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
    assert summary.statistics.message_count == len(found)
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count
    names = [one.name for one in reader.iter_attachments()]
    return found, names, [one.name for one in reader.iter_metadata()]


@pytest.mark.parametrize("share", [0.35, 0.99])
def test_a_cut_file_gets_its_index_and_keeps_every_message(write_session, sent, share):
    path = write_session(*sent.items(), close=False)
    os.truncate(path, int(path.stat().st_size * share))
    killed = open_session(path)
    before = {topic: list(killed.messages(topic)) for topic in killed.topics}
    (done,) = repair_session(path)
    assert (done.path, done.messages) == (path, sum(killed.topics.values()))
    assert done.dropped == killed.unread
    repaired = open_session(path)
    assert repaired.complete
    assert {topic: list(repaired.messages(topic)) for topic in repaired.topics} == before
    found, attachments, metadata = by_stock_reader(path)
    assert len(found) == done.messages
    assert (attachments, metadata) == (["motion.csv"], ["g1stream", "g1stream.repaired"])
    assert any("did not close the file" in one for one in repaired.summary().problems)
    passes_doctor(path)
    again = path.read_bytes()
    assert repair_session(path)[0].dropped is None
    assert path.read_bytes() == again


def write_loose(path, *, chunks_behind=False, finish=True):
    """100 messages of two topics outside of chunks, and as many in chunks behind them if asked."""
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("", "another program")
        schema = writer.register_schema("a/Type", "ros2msg", b"uint8 x")
        channels = [
            writer.register_channel(topic, "cdr", schema, {"callerid": topic})
            for topic in ("/lowstate", "/other")
        ]
        writer.add_metadata("theirs", {"key": "value"})
        writer.add_attachment(5, 6, "a.txt", "text/plain", b"text")
        for i in range(100):
            writer.add_message(channels[i % 2], i, bytes([i]), 1000 + i, i)
        if finish:
            writer.finish()
    if not chunks_behind:
        return path
    loose, behind = path.read_bytes(), path.with_name("behind.mcap")
    with behind.open("wb") as file:
        writer = Writer(file, chunk_size=200)
        writer.start("", "another program")
        for topic in ("/lowstate", "/other"):
            writer.register_channel(topic, "cdr", 0)
        for i in range(100, 200):
            writer.add_message(1 + i % 2, i, bytes([i]), 1000 + i, i)
        writer.flush()
    head = behind.read_bytes().index(bytes([Opcode.CHUNK]), 8 + 9)
    path.write_bytes(loose + behind.read_bytes()[head:])
    return path


@pytest.mark.parametrize(
    ("finish", "chunks_behind"), [(True, False), (False, False), (False, True)]
)
def test_messages_outside_of_chunks_are_read_and_kept(tmp_path, finish, chunks_behind):
    path = write_loose(tmp_path / "s.mcap", chunks_behind=chunks_behind, finish=finish)
    n = 200 if chunks_behind else 100
    expected = {
        topic: [(i, 1000 + i, bytes([i])) for i in range(first, n, 2)]
        for first, topic in enumerate(("/lowstate", "/other"))
    }

    def read():
        session = open_session(path)
        assert session.topics == {"/lowstate": n // 2, "/other": n // 2}
        return {topic: [tuple(m) for m in session.messages(topic)] for topic in session.topics}

    assert read() == expected
    (done,) = repair_session(path)
    assert (done.messages, done.dropped) == (n, 0)
    assert read() == expected
    found, attachments, metadata = by_stock_reader(path)
    assert sorted(found) == sorted((t, i, data) for t in expected for i, _, data in expected[t])
    assert (attachments, metadata) == (["a.txt"], ["theirs"])
    channels = stock_reader(path).get_summary().channels.values()
    assert {one.topic: one.metadata for one in channels} == {
        topic: {"callerid": topic} for topic in expected
    }
    assert repair_session(path)[0].dropped is None


@pytest.mark.parametrize("share", [None, 0.01, 0.9, 1.0])
def test_what_was_before_a_tail_of_zeros_is_read_and_kept(write_session, sent, share):
    path = write_session(*sent.items(), close=False)
    content = path.read_bytes()
    chunk = McapFile(path)._chunks[-2].record  # that of the last topic is tiny
    path.write_bytes(content[: chunk.start - 9])
    before = McapFile(path).counts
    end = chunk.start - 29  # within the index of the chunk before
    if share is not None:
        end = chunk.start + int(share * chunk.length)
    path.write_bytes(content[:end] + bytes(len(content) - end))
    damaged = open_session(path)
    messages = {topic: list(damaged.messages(topic)) for topic in damaged.topics}
    counts = {topic: len(found) for topic, found in messages.items()}
    if share != 1.0:
        assert counts == before
        assert damaged.unread >= len(content) - (chunk.start - 9)
    else:
        assert sum(counts.values()) > before.total()
    assert "are an incomplete record" in " ".join(damaged.summary().problems)
    (done,) = repair_session(path)
    assert (done.messages, done.dropped) == (sum(counts.values()), damaged.unread)
    repaired = open_session(path)
    assert {topic: list(repaired.messages(topic)) for topic in repaired.topics} == messages
    assert len(by_stock_reader(path)[0]) == done.messages


def twice(content):
    return content + content, f"several MCAP files.*at byte {len(content)} of"


def damaged(content):
    place = content.index(b"zstd") + 40
    return content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :], "damaged"


@pytest.mark.parametrize(("close", "spoil"), [(True, twice), (False, damaged)])
def test_what_cannot_be_repaired_stays_as_it_is(write_session, sent, tmp_path, close, spoil):
    path = write_session(*sent.items(), close=close)
    content, told = spoil(path.read_bytes())
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=told):
        repair_session(path)
    assert path.read_bytes() == content
    assert [one.name for one in tmp_path.iterdir()] == ["session.mcap"]


RECORDER = """
import sys, time
from g1stream.session.writer import SessionWriter
writer = SessionWriter(sys.argv[1], split_ns=1_000_000_000)
for i in range(700):
    writer.write("/lowcmd", bytes(1008), i * 5_000_000, i * 5_000_000)
    writer.flush_if_due(i * 5_000_000)
print("written", flush=True)
time.sleep(60)
"""


def metadata_of(directory):
    text = (directory / "metadata.yaml").read_text()
    return yaml.safe_load(text)["rosbag2_bagfile_information"]


def test_the_parts_of_a_killed_recorder_are_mended_but_not_while_it_records(tmp_path):
    directory = tmp_path / "s"
    command = [sys.executable, "-c", RECORDER, str(tmp_path / "s.mcap")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "written\n"
            with pytest.raises(RecordingError, match="still being recorded"):
                repair_session(directory)
        finally:
            process.send_signal(signal.SIGKILL)
    done = repair_session(directory)
    assert [one.dropped for one in done] == [None, None, None, 0]
    session = open_session(directory)
    assert session.complete
    times = [message.log_time for message in session.messages("/lowcmd")]
    assert times == [i * 5_000_000 for i in range(len(times))]
    about = metadata_of(directory)
    assert about["message_count"] == len(times) == sum(one.messages for one in done)
    assert about["duration"]["nanoseconds"] == times[-1]
    assert len(times) > 650
    # A part that cannot be read keeps no other from its index.
    first, empty, cut, last = session.paths
    empty.write_bytes(b"")
    cut.write_bytes(cut.read_bytes()[:-200])
    with pytest.raises(RecordingError, match=empty.name):
        repair_session(directory)
    assert McapFile(cut).indexed
    kept = [McapFile(path).counts.total() for path in (first, cut, last)]
    assert metadata_of(directory)["message_count"] == sum(kept)
