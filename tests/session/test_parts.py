import numpy as np
import pytest
import yaml

from g1stream.app.session import open_session
from g1stream.errors import RecordingError
from g1stream.session.format import metadata_from_strings
from g1stream.session.parts import check_recording_path
from g1stream.session.source import SessionFiles
from g1stream.session.writer import SessionWriter
from written_sessions import stock_reader

T0 = 1_700_000_000_000_000_000
MS = 1_000_000
SECOND = 1000 * MS
STEP = 100 * MS
N = 60
PART_NS = 2 * SECOND


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(3)
    return {topic: [rng.bytes(1000) for _ in range(N)] for topic in ("/lowcmd", "/lowstate")}


def file_header(writer):
    writer.add_metadata({"host": "here"})
    writer.attach("robot.urdf", "application/xml", b"<robot/>", T0)
    writer.write("/log", b"", T0, T0)


@pytest.fixture
def write_parts(tmp_path, samples):
    """Writes N samples of both topics in parts of two seconds: three parts."""

    def write(**options):
        settings = {"split_ns": PART_NS, "file_header": file_header, **options}
        with SessionWriter(tmp_path / "session.mcap", **settings) as writer:
            for i in range(N):
                for topic, data in samples.items():
                    writer.write(topic, data[i], T0 + i * STEP + 9, T0 + i * STEP)
                writer.flush_if_due(T0 + i * STEP + 9)
            writer.add_metadata({"at_end": True})
        return writer

    return write


def read(path):
    """Messages (topic, message), metadata and attachments, by the stock reader."""
    reader, metadata = stock_reader(path, validate_crcs=True), {}
    for one in reader.iter_metadata():
        metadata |= metadata_from_strings(one.metadata)
    attached = [one.name for one in reader.iter_attachments()]
    return [(c.topic, m) for _, c, m in reader.iter_messages()], metadata, attached


def test_each_part_is_whole_by_itself_and_nothing_is_lost_between(write_parts, tmp_path):
    writer = write_parts()
    assert writer.path == tmp_path / "session"
    assert writer.paths == [tmp_path / "session" / f"session_{i}.mcap" for i in range(3)]
    times, sequences = [], []
    for number, path in enumerate(writer.paths):
        messages, metadata, attached = read(path)
        assert metadata.items() >= {"host": "here", "part": number}.items()
        assert attached == ["robot.urdf"]
        assert [topic for topic, _ in messages].count("/log") == 1
        of_part = [m for topic, m in messages if topic == "/lowcmd"]
        assert of_part[-1].log_time - of_part[0].log_time <= 2 * SECOND + STEP
        times += [m.publish_time for m in of_part]
        sequences += [m.sequence for m in of_part]
    assert times == [T0 + STEP * i for i in range(N)]
    assert sequences == list(range(1, N + 1))
    assert writer.counts == {"/log": 3, "/lowcmd": N, "/lowstate": N}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["session"]


def test_the_directory_is_read_as_one_session(write_parts, samples):
    writer = write_parts()
    session = open_session(writer.path)
    assert session.paths == writer.paths
    assert session.complete
    assert not session.absent_parts
    assert session.topics == {"/log": 3, "/lowcmd": N, "/lowstate": N}
    for topic, data in samples.items():
        assert list(session.replay_bytes(topic)) == data
    assert session.metadata.items() >= {"host": "here", "at_end": True}.items()
    assert session.attachments == {"robot.urdf": b"<robot/>"}
    writer.path.rename(writer.path.with_name("renamed"))
    assert open_session(writer.path.with_name("renamed")).topics["/lowcmd"] == N


@pytest.mark.parametrize("content", [None, b"", bytes(4096)])
def test_a_missing_or_unreadable_part_is_absent_with_its_reason(write_parts, samples, content):
    writer = write_parts()
    first, middle, last = writer.paths
    middle.unlink()
    if content is not None:
        middle.write_bytes(content)
    session = open_session(writer.path)
    assert list(session.absent_parts) == [1]
    assert str(middle) in session.absent_parts[1]
    assert session.paths == [first, last]
    assert not session.complete
    assert list(session.replay_bytes("/lowcmd"))[-1] == samples["/lowcmd"][-1]
    with pytest.raises(RecordingError):
        open_session(middle)


def test_without_any_readable_part_there_is_no_session(write_parts):
    writer = write_parts()
    for path in writer.paths:
        path.write_bytes(b"")
    with pytest.raises(RecordingError, match=str(writer.paths[0])):
        SessionFiles(writer.path)


def test_parts_are_listed_as_soon_as_they_are_begun(tmp_path):
    with SessionWriter(tmp_path / "s", split_ns=PART_NS) as writer:
        for time in range(T0, T0 + N * STEP, STEP):
            writer.write("/lowcmd", b"x", time, time)
            writer.flush_if_due(time)
            assert SessionFiles(tmp_path / "s").paths == writer.paths
    assert len(writer.paths) == 3


@pytest.mark.parametrize(
    "content", ["", "{", "rosbag2_bagfile_information: {}", "rosbag2_bagfile_information: 3"]
)
def test_a_directory_that_is_no_recording(write_parts, content):
    path = write_parts().path
    (path / "metadata.yaml").write_text(content)
    with pytest.raises(RecordingError, match=r"metadata\.yaml"):
        open_session(path)
    (path / "metadata.yaml").unlink()
    with pytest.raises(RecordingError, match=r"metadata\.yaml"):
        open_session(path)


def test_metadata_yaml_has_the_fields_of_rosbag2(write_parts):
    """By the specification of BagMetadata, version 6."""
    path = write_parts().path
    about = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert about["version"] == 6
    assert about["storage_identifier"] == "mcap"
    assert (about["compression_format"], about["compression_mode"]) == ("", "")
    assert about["relative_file_paths"] == [f"session_{i}.mcap" for i in range(3)]
    assert [file["path"] for file in about["files"]] == about["relative_file_paths"]
    assert about["starting_time"] == {"nanoseconds_since_epoch": T0}
    assert about["duration"] == {"nanoseconds": (N - 1) * STEP + 9}
    assert about["message_count"] == sum(f["message_count"] for f in about["files"]) == 2 * N
    # One serialisation format only: with /log, which is protobuf, rosbag2 refuses the directory.
    assert {
        topic["topic_metadata"]["name"]: (topic["topic_metadata"]["type"], topic["message_count"])
        for topic in about["topics_with_message_count"]
    } == {"/lowcmd": ("unitree_hg/msg/LowCmd", N), "/lowstate": ("unitree_hg/msg/LowState", N)}
    for topic in about["topics_with_message_count"]:
        assert topic["topic_metadata"]["serialization_format"] == "cdr"
        assert topic["topic_metadata"]["offered_qos_profiles"] == ""
    assert all(isinstance(value, str) for value in about["custom_data"].values())


def record(writer, seconds, payload=bytes(8)):
    """100 LowCmds a second, handed over ten times a second."""
    for start in range(0, round(seconds * 1000), 100):
        times = T0 + (start + 10 * np.arange(10)) * MS
        writer.write_batch("/lowcmd", [payload] * 10, times, times)
        writer.flush_if_due(int(times[-1]))


def test_parts_end_with_the_chunk_that_reaches_their_size(tmp_path):
    noise = np.random.default_rng(1).bytes(10_000)
    with SessionWriter(tmp_path / "s.mcap", split_bytes=20_000) as writer:
        record(writer, 2, noise)
    sizes = [path.stat().st_size for path in writer.paths]
    assert len(sizes) > 2
    assert all(20_000 <= size < 60_000 for size in sizes[:-1])
    assert sum(len(read(path)[0]) for path in writer.paths) == 200


def test_the_file_header_does_not_count_as_size(tmp_path):
    def large(writer):
        writer.attach("robot.urdf", "application/xml", bytes(100_000), T0)

    with SessionWriter(tmp_path / "s.mcap", split_bytes=50_000, file_header=large) as writer:
        record(writer, 0.2)
        assert len(writer.paths) == 1
        record(writer, 2, np.random.default_rng(1).bytes(10_000))
    assert len(writer.paths) > 1


def test_a_clock_set_back_ends_a_part(tmp_path):
    with SessionWriter(tmp_path / "s.mcap", split_ns=SECOND) as writer:
        record(writer, 0.5)
        writer.flush_if_due(T0 - 3600 * SECOND)
    assert len(writer.paths) == 2


@pytest.mark.parametrize("where", ["before", "after"])
def test_if_no_part_can_be_begun_the_last_one_takes_the_final_metadata(tmp_path, where):
    headers = []

    def once(writer):
        if where == "after" or not headers:
            file_header(writer)
        if headers:
            raise RecordingError("The disk is full.", "Make room.")
        headers.append(writer)

    with SessionWriter(tmp_path / "s.mcap", split_ns=SECOND, file_header=once) as writer:
        with pytest.raises(RecordingError, match="full"):
            record(writer, 2)
        writer.add_metadata({"at": "end"})
    names = sorted(path.name for path in writer.path.iterdir())
    assert names == ["metadata.yaml", "s_0.mcap"]
    messages, metadata, _ = read(writer.paths[0])
    assert metadata["at"] == "end"
    assert writer.counts == {"/log": 1, "/lowcmd": len(messages) - 1}
    assert SessionFiles(writer.path).complete


def content(directory):
    return {path: path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def test_a_recording_is_replaced_only_with_force_and_once_the_first_part_stands(
    write_parts, tmp_path
):
    write_parts()
    before = content(tmp_path)
    with pytest.raises(RecordingError) as error:
        write_parts()
    assert "--force" in error.value.remedy
    assert content(tmp_path) == before

    def fail(writer):
        file_header(writer)
        assert content(tmp_path).items() >= before.items()
        raise RecordingError("The disk is full.", "Make room.")

    forced = {"split_ns": PART_NS, "force": True}
    with pytest.raises(RecordingError, match="full"):
        SessionWriter(tmp_path / "session.mcap", file_header=fail, **forced)
    assert content(tmp_path) == before
    with SessionWriter(tmp_path / "session.mcap", **forced) as writer:
        assert writer.paths == [tmp_path / "session" / "session_0.mcap"]
        writer.write("/log", b"", T0, T0)
        writer.flush()
        assert content(tmp_path).items() >= before.items()
        writer.write("/lowstate", b"x", T0, T0)
        writer.flush()
        assert sorted(content(tmp_path)) == [writer.path / "metadata.yaml", writer.paths[0]]


def other_bag(path):
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace("g1stream", "other"))


def no_directory(path):
    path.rename(path.with_name("moved"))
    path.write_bytes(b"precious")


def link(path):
    path.rename(path.with_name("moved"))
    path.symlink_to("moved")


@pytest.mark.parametrize(
    "change",
    [
        lambda path: (path / "notes.txt").write_bytes(b"precious"),
        lambda path: (path / "metadata.yaml").unlink(),
        other_bag,
        no_directory,
        link,
    ],
)
def test_nothing_else_is_replaced(write_parts, tmp_path, change):
    change(write_parts().path)
    before = content(tmp_path)
    for force in (True, False):
        with pytest.raises(RecordingError):
            write_parts(force=force)
        with pytest.raises(RecordingError):
            check_recording_path(tmp_path / "session.mcap", split=True, force=force)
    assert content(tmp_path) == before


@pytest.mark.parametrize("split_ns", [None, PART_NS])
def test_a_recording_without_a_sample_replaces_nothing(tmp_path, split_ns):
    def write(**options):
        return SessionWriter(tmp_path / "session.mcap", split_ns=split_ns, **options)

    with write() as writer:
        writer.write("/lowstate", b"x", T0, T0)
    before = content(tmp_path)
    with write(force=True, file_header=file_header) as writer:
        writer.write("/log", b"", T0, T0)
    assert writer.paths == []
    assert content(tmp_path) == before
