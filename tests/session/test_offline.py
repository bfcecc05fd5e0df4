"""Files of the offline writer, read by the stock reader with every checksum verified."""

import os
import subprocess
import sys
import zlib

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Chunk, ChunkIndex, Footer, MessageIndex, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from g1stream.errors import RecordingError
from g1stream.session.format import CHANNELS
from g1stream.session.offline import OfflineWriter

T0 = 1_700_000_000_000_000_000
TOPICS = ("/tf", "/reference/joint_states")


@pytest.fixture
def rows():
    """Two topics with 300 messages each, of different sizes."""
    rng = np.random.default_rng(4)
    return {
        topic: rng.integers(0, 256, (300, size), dtype=np.uint8)
        for topic, size in zip(TOPICS, (700, 90), strict=True)
    }


STAMPS = T0 + 10_000_000 * np.arange(300)


def write(path, rows, compression="zstd"):
    with OfflineWriter(path, compression=compression) as writer:
        for topic in TOPICS:
            writer.add_channel(CHANNELS[topic])
        writer.add_metadata({"frames": 300})
        writer.attach("a.csv", "text/csv", b"1,2", T0)
        for first in range(0, 300, 128):
            part = slice(first, first + 128)
            writer.write({topic: data[part] for topic, data in rows.items()}, STAMPS[part])
    return path


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_the_stock_reader_finds_every_message(tmp_path, rows, compression):
    path = write(tmp_path / "a.mcap", rows, compression)
    with path.open("rb") as file:
        read = list(make_reader(file, validate_crcs=True).iter_messages(log_time_order=False))
    assert [(c.topic, m.sequence, m.log_time, m.publish_time) for _, c, m in read] == [
        (topic, i + 1, STAMPS[i], STAMPS[i]) for i in range(300) for topic in TOPICS
    ]
    for topic, data in rows.items():
        assert [m.data for _, c, m in read if c.topic == topic] == [row.tobytes() for row in data]
    with path.open("rb") as file:
        chunks = [r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)]
    assert {chunk.compression for chunk in chunks} == {"" if compression == "none" else compression}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # mcap 1.5 has no other names for it
def test_a_time_range_is_found_through_the_indexes(tmp_path, rows):
    path = write(tmp_path / "a.mcap", rows)
    with path.open("rb") as file:
        found = make_reader(file).iter_messages(
            topics=["/reference/joint_states"],
            start_time=int(STAMPS[130]),
            end_time=int(STAMPS[260]),
        )
        assert [m.sequence for _, _, m in found] == list(range(131, 261))


def records(path):
    with path.open("rb") as file:
        return list(StreamReader(file, validate_crcs=True).records)


def test_the_indexes_are_those_that_the_stock_writer_makes(tmp_path, rows):
    """The same content by the stock writer: the records that describe it must be the same."""
    ours = write(tmp_path / "ours.mcap", rows, "none")
    theirs = tmp_path / "theirs.mcap"
    with theirs.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(library="g1stream")
        ids = {}
        for topic in TOPICS:
            channel = CHANNELS[topic]
            schema = writer.register_schema(
                channel.schema_name, channel.schema_encoding, channel.build_schema()
            )
            about = {"description": channel.description}
            ids[topic] = writer.register_channel(topic, channel.message_encoding, schema, about)
        writer.add_metadata("g1stream", {"frames": "300"})
        writer.add_attachment(T0, T0, "a.csv", "text/csv", b"1,2")
        for i, stamp in enumerate(STAMPS.tolist()):
            if i in (128, 256):
                writer.flush()
            for topic in TOPICS:
                writer.add_message(ids[topic], stamp, rows[topic][i].tobytes(), stamp, i + 1)
        writer.finish()

    def described(path, kind):
        return [r for r in records(path) if isinstance(r, kind)]

    for kind in (Statistics, MessageIndex, Attachment):
        assert described(ours, kind) == described(theirs, kind)
    spans = [
        [(c.message_start_time, c.message_end_time) for c in described(path, ChunkIndex)]
        for path in (ours, theirs)
    ]
    assert spans[0] == spans[1]
    assert len(spans[0]) == 3


def test_the_summary_checksum_is_right(tmp_path, rows):
    path = write(tmp_path / "a.mcap", rows)
    (footer,) = (r for r in records(path) if isinstance(r, Footer))
    content = path.read_bytes()
    # From the summary's start up to the footer's last field, by the specification.
    assert footer.summary_crc == zlib.crc32(content[footer.summary_start : -8 - 4])


def test_a_failure_leaves_nothing_behind(tmp_path, rows):
    def interrupted():
        with OfflineWriter(tmp_path / "a.mcap") as writer:
            writer.add_channel(CHANNELS["/tf"])
            writer.write({"/tf": rows["/tf"]}, STAMPS)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_a_failure_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(ZeroDivisionError), OfflineWriter(path, force=True):
        raise ZeroDivisionError
    assert path.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [path]


def test_the_name_is_taken_only_by_a_whole_file(tmp_path, rows):
    path = tmp_path / "a.mcap"
    with OfflineWriter(path) as writer:
        writer.add_channel(CHANNELS["/tf"])
        writer.write({"/tf": rows["/tf"]}, STAMPS)
        assert not path.exists()
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_replaced_only_when_forced(tmp_path, rows):
    path = write(tmp_path / "a.mcap", rows)
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"a\.mcap exists already\. .*--force"):
        OfflineWriter(path)
    assert path.read_bytes() == before
    with OfflineWriter(path, force=True):
        pass
    assert path.read_bytes() != before


def test_a_file_that_came_in_the_meantime_is_not_replaced(tmp_path):
    path = tmp_path / "a.mcap"
    with pytest.raises(RecordingError, match="exists already"), OfflineWriter(path):
        path.write_bytes(b"precious")
    assert path.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path):
    path, link = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.touch()
    link.symlink_to(path)
    with OfflineWriter(link, force=True):
        pass
    assert link.is_symlink()
    assert path.stat().st_size > 0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere/a.mcap", "does not exist. Make it: mkdir -p"),
        (".", "is a directory"),
        ("pipe", "is not a file"),
    ],
)
def test_places_where_no_file_can_be(tmp_path, name, message):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match=message):
        OfflineWriter(tmp_path / name, force=True)


FULL = """
import resource, signal, sys
import numpy as np
from g1stream.errors import RecordingError
from g1stream.session.format import CHANNELS
from g1stream.session.offline import OfflineWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, 500_000))
noise = np.random.default_rng(3).integers(0, 256, (500, 2000), dtype=np.uint8)
try:
    with OfflineWriter(sys.argv[1]) as writer:
        writer.add_channel(CHANNELS["/tf"])
        writer.write({"/tf": noise}, np.arange(500))
except RecordingError as error:
    print(error.cause)
"""


def test_a_full_disk_is_said_and_left_as_it_was(tmp_path):
    path = tmp_path / "a.mcap"
    command = [sys.executable, "-c", FULL, str(path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout == f"The file {path} cannot be written: File too large.\n"
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_from_the_start_leaves_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("g1stream.session.offline.ChunkedFile", full)
    with pytest.raises(RecordingError, match="No space left"):
        OfflineWriter(tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []
