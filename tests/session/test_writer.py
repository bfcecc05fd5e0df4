import gc
import signal
import struct
import subprocess
import sys
from collections import defaultdict
from contextlib import suppress
from io import BytesIO
from unittest.mock import Mock

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Chunk, ChunkIndex, DataEnd, Message
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros2.decoder import DecoderFactory as Ros2Decoders

from g1stream.errors import RecordingError
from g1stream.session import writer as writer_module
from g1stream.session.format import CHANNELS, metadata_from_strings
from g1stream.session.records import MotionInfo
from g1stream.session.source import SessionFiles
from g1stream.session.writer import SessionWriter, attach_motion
from g1stream.view.encoders import JointStatesTemplate
from written_sessions import stock_reader

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


def read_all(path):
    """Every message in file order, by the stock reader."""
    return list(stock_reader(path).iter_messages(log_time_order=False))


def chunks_of(path):
    records = StreamReader(BytesIO(path.read_bytes()), emit_chunks=True).records
    return [record for record in records if isinstance(record, Chunk)]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "session.mcap"


def test_stock_readers_decode_both_kinds_of_channel(path, golden):
    state = golden["lowstate"][1]
    rows = JointStatesTemplate(["a", "b"], ("position",)).encode([T0, T0 + 1], [[1, 2], [3, 4]])
    with SessionWriter(path) as writer:
        writer.write("/lowstate", bytes.fromhex(state["cdr"]), T0 + 5, T0)
        writer.write_batch("/measured/joint_states", rows, [T0 + 5, T0 + 6], [T0, T0 + 1])
    decoders = [ProtobufDecoders(), Ros2Decoders()]
    reader = stock_reader(path, validate_crcs=True, decoder_factories=decoders)
    decoded = defaultdict(list)
    for _, channel, _, message in reader.iter_decoded_messages():
        assert channel.metadata["description"]
        decoded[channel.topic].append(message)
    assert decoded["/lowstate"][0].tick == state["tick"]
    positions = [[j.position for j in m.joints] for m in decoded["/measured/joint_states"]]
    assert positions == [[1, 2], [3, 4]]


def test_chunks_are_compressed_and_read_by_the_stock_reader(path):
    rows = np.arange(600, dtype=np.uint8).reshape(300, 2)
    times = T0 + MS * np.arange(300)
    with SessionWriter(path) as writer:
        for part in (slice(0, 128), slice(128, 300)):
            writer.write_batch("/tf", rows[part], times[part], times[part])
            writer.flush()
    assert [(m.log_time, m.sequence, m.data) for _, _, m in read_all(path)] == [
        (times[i], i + 1, rows[i].tobytes()) for i in range(300)
    ]
    assert [chunk.compression for chunk in chunks_of(path)] == ["zstd", "zstd"]


def test_a_chunk_spans_less_than_its_time_also_after_the_clock_was_set_back(path):
    with SessionWriter(path) as writer:
        for start in (T0, T0 - 10**12):
            for times in np.split(start + 2 * MS * np.arange(500), 20):
                writer.write_batch("/lowstate", [b"x"] * 25, times, times)
                writer.flush_if_due(int(times[-1]))
    spans = [chunk.message_end_time - chunk.message_start_time for chunk in chunks_of(path)]
    assert spans == [248 * MS] * 8


def test_the_index_of_the_chunks_is_whole_and_not_held_in_memory(path, tmp_path):
    def held():
        gc.collect()
        return sum(isinstance(one, ChunkIndex) for one in gc.get_objects())

    before, times = held(), list(range(T0, T0 + 30_000 * MS, 250 * MS))
    with SessionWriter(path) as writer:
        for time in times:
            writer.write("/lowstate", b"x", time, time)
            writer.flush_if_due(time + 250 * MS)
        assert held() <= before
    indexes = stock_reader(path).get_summary().chunk_indexes
    assert [one.message_start_time for one in indexes] == times
    assert [message.log_time for _, _, message in read_all(path)] == times
    assert sorted(tmp_path.iterdir()) == [path]


def test_a_quiet_topic_is_on_disk_once_its_time_has_run_out(path):
    with SessionWriter(path) as writer:
        writer.write("/log", b"x", T0, T0)
        writer.flush_if_due(T0 + 249 * MS)
        assert readable(path) == []
        writer.flush_if_due(T0 + 250 * MS)
        assert readable(path) == [T0]


def readable(path):
    """Log times of what the stock reader finds in a file that was never closed."""
    times = []
    with path.open("rb") as file, suppress(EndOfFile, struct.error):
        for record in StreamReader(file, validate_crcs=True).records:
            assert not isinstance(record, DataEnd), "the file was closed"
            times += [record.log_time] if isinstance(record, Message) else []
    return times


KILLED = """
import sys
from g1stream.session.writer import SessionWriter
writer = SessionWriter(sys.argv[1])
writer.add_metadata({"host": "here"})
for i in range(10**6):
    writer.write("/lowstate", bytes(2096), i * 2_000_000, i * 2_000_000)
    print(i * 2_000_000, flush=True)
"""


def test_a_killed_recorder_loses_less_than_its_chunk(path):
    command = [sys.executable, "-c", KILLED, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for _ in range(400):
            written = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        process.stdout.read()
    times = readable(path)
    assert times == list(range(0, len(times) * 2 * MS, 2 * MS))
    assert times[-1] > written - 250 * MS


def test_metadata_and_attachments(path):
    with SessionWriter(path) as writer:
        writer.add_metadata({"domain": 1, "gains": {"kp": np.array([60.0, 40.0])}})
        writer.attach("g1.urdf", "application/xml", b"<robot/>", T0)
        writer.write("/lowstate", b"x", T0, T0)
        writer.add_metadata({"gaps": []})
    records = list(stock_reader(path).iter_metadata())
    (attachment,) = stock_reader(path).iter_attachments()
    assert [record.name for record in records] == ["g1stream", "g1stream.2"]
    assert metadata_from_strings(records[0].metadata) == {"domain": 1, "gains": {"kp": [60, 40]}}
    assert metadata_from_strings(records[1].metadata) == {"gaps": []}
    assert (attachment.name, attachment.data) == ("g1.urdf", b"<robot/>")
    assert (attachment.log_time, attachment.media_type) == (T0, "application/xml")


@pytest.mark.parametrize(
    ("topics", "profile"), [(["/lowcmd", "/lowstate"], "ros2"), (CHANNELS, "")]
)
def test_the_profile_is_that_of_ros2_where_all_channels_are_cdr(path, topics, profile):
    with SessionWriter(path, channels={topic: CHANNELS[topic] for topic in topics}) as writer:
        writer.write("/lowstate", b"x", T0, T0)
    assert stock_reader(path).get_header().profile == profile


def test_a_file_is_replaced_only_when_forced_and_whole_after_an_exception(path):
    path.write_bytes(b"precious")
    with pytest.raises(RecordingError) as error:
        SessionWriter(path)
    assert "--force" in error.value.remedy
    assert path.read_bytes() == b"precious"

    def record():
        with SessionWriter(path, force=True) as writer:
            writer.write("/lowstate", b"x", T0, T0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert len(read_all(path)) == 1


FULL = """
import resource, sys
import numpy as np
from g1stream.errors import RecordingError
from g1stream.session.writer import SessionWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
noise = np.random.default_rng(3).integers(0, 256, (1000, 2096), dtype=np.uint8)
times = np.arange(1000) * 2_000_000
with SessionWriter(sys.argv[1]) as writer:
    try:
        for data, time in zip(noise, times.tolist()):
            writer.write("/lowstate", data.tobytes(), time, time)
    except RecordingError:
        writer.write("/log", b"full", 10**10, 10**10)
        writer.add_metadata({"stopped": "full"})
        print(writer.counts["/lowstate"])
"""


def test_a_write_that_fails_midway_keeps_what_is_whole(path):
    """As on a file system that cannot reserve space: no index, but a whole file all the same."""
    command = [sys.executable, "-c", FULL, str(path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    kept = list(range(0, 3 * 250 * MS, 2 * MS))
    assert int(result.stdout) == len(kept)
    assert [m.log_time for _, c, m in read_all(path) if c.topic == "/lowstate"] == kept
    assert [m.data for _, c, m in read_all(path) if c.topic == "/log"] == [b"full"]
    files = SessionFiles(path)
    assert files.complete
    assert files.topics == {"/lowstate": len(kept), "/log": 1}
    assert files.metadata == {"stopped": "full"}


@pytest.fixture
def attached(tmp_path, monkeypatch):
    """Writes these files, and gives the attachments of a motion that was read from them."""
    monkeypatch.setattr(writer_module, "LARGEST_MOTION", 8)

    def attach(*files, joined=False):
        for name, data in files:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(data)
        of = [MotionInfo(source=str(tmp_path / name)) for name, _ in files]
        taker = Mock()
        for motion in [MotionInfo(parts=[*of, of[0]])] if joined else of:
            attach_motion(taker, motion, 7)
        return [call.args for call in taker.attach.call_args_list]

    return attach


def test_a_motion_file_is_attached_with_its_type(attached):
    assert attached(("walk.csv", b"1,2"), ("W.CSV", b"3"), ("w.npz", b"4")) == [
        ("walk.csv", "text/csv", b"1,2", 7),
        ("W.CSV", "text/csv", b"3", 7),
        ("w.npz", "application/octet-stream", b"4", 7),
    ]


def test_neither_a_session_nor_a_large_file_nor_a_missing_one_is_attached(attached, tmp_path):
    assert attached(("earlier.mcap", b"\x89MCAP0\r\n"), ("large.csv", bytes(9))) == []
    taker = Mock()
    for motion in (None, MotionInfo(), MotionInfo(source=str(tmp_path / "gone.csv"))):
        attach_motion(taker, motion, 7)
    attach_motion(taker, MotionInfo(source=str(tmp_path)), 7)
    assert not taker.attach.called


def test_each_file_of_a_joined_motion_is_attached_once(attached):
    files = ("a.csv", b"1"), ("b.csv", b"2"), ("below/a.csv", b"3")
    assert [(name, data) for name, _, data, _ in attached(*files, joined=True)] == [
        ("a.csv", b"1"),
        ("b.csv", b"2"),
        ("a-2.csv", b"3"),
    ]
