"""A session in several files is read as one."""

import numpy as np
import pytest

from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.dds.topics import LOWCMD, LOWSTATE
from g1stream.errors import RecordingError
from g1stream.session.rotation import Limits, PartedWriter
from g1stream.session.session import open_session

T0 = 1_700_000_000_000_000_000
STEP = 100_000_000
N = 60
TWO_SECONDS = Limits(duration=2_000_000_000)


@pytest.fixture
def samples():
    rng = np.random.default_rng(3)

    def some(topic):
        size = Layout.of(topic.message.idl_type).sample_size
        return [CDR_HEADER + rng.bytes(size - len(CDR_HEADER)) for _ in range(N)]

    return {"/lowcmd": some(LOWCMD), "/lowstate": some(LOWSTATE)}


@pytest.fixture
def write_parts(tmp_path, samples):
    """Writes N samples of both topics in parts of two seconds: three parts."""

    def write(name="session.mcap", limits=TWO_SECONDS, last_words=None):
        def preface(writer):
            writer.add_metadata({"host": "here"})
            writer.attach("robot.urdf", "application/xml", b"<robot/>", T0)

        path = tmp_path / name
        with PartedWriter(path, preface, limits) as writer:
            for i in range(N):
                for topic, data in samples.items():
                    writer.write(topic, data[i], T0 + i * STEP + 9, T0 + i * STEP)
                writer.flush_if_due(T0 + i * STEP + 9)
            writer.add_metadata({"at_end": True, **(last_words or {})})
        return writer.paths

    return write


def test_any_part_opens_them_all(write_parts, samples):
    paths = write_parts()
    assert len(paths) == 3
    for path in paths:
        session = open_session(path)
        assert session.paths == paths
        assert session.complete
        assert not session.absent_parts
        assert session.topics == {"/lowcmd": N, "/lowstate": N}
        assert list(session.replay_bytes("/lowstate")) == samples["/lowstate"]
        np.testing.assert_array_equal(
            session.times["/lowcmd"].publish_time, T0 + STEP * np.arange(N, dtype=np.int64)
        )
        assert session.metadata["host"] == "here"
        assert session.metadata["at_end"] is True
        assert session.attachments == {"robot.urdf": b"<robot/>"}


def test_the_name_they_are_called_after_opens_them_too(write_parts, tmp_path):
    paths = write_parts()
    assert open_session(tmp_path / "session.mcap").paths == paths


def test_a_part_that_is_gone_is_missed(write_parts, samples):
    paths = write_parts()
    paths[1].unlink()
    session = open_session(paths[2])
    assert session.absent_parts == [2]
    assert session.unreadable_parts == {}
    assert not session.complete
    found = list(session.replay_bytes("/lowcmd"))
    assert 0 < len(found) < N
    assert found[-1] == samples["/lowcmd"][-1]


def test_the_first_part_that_is_gone_is_missed(write_parts):
    paths = write_parts()
    paths[0].unlink()
    assert open_session(paths[1]).absent_parts == [1]


def test_the_part_of_a_killed_recorder_is_not_complete(write_parts):
    paths = write_parts()
    content = paths[2].read_bytes()
    paths[2].write_bytes(content[: len(content) // 2])
    session = open_session(paths[0])
    assert not session.complete
    assert not session.absent_parts
    assert 0 < session.topics["/lowcmd"] < N


def test_parts_of_another_session_are_left_out(write_parts):
    ours, others = write_parts(), write_parts("other.mcap")
    others[2].rename(ours[0].with_name("session_004.mcap"))
    session = open_session(ours[0])
    assert session.paths == ours
    assert session.complete


def test_a_part_that_is_no_mcap_is_absent_and_named_when_asked_for(write_parts):
    paths = write_parts()
    paths[1].write_text("oops")
    session = open_session(paths[0])
    assert session.absent_parts == [2]
    assert session.unreadable_parts == {2: f"{paths[1]} is not an MCAP file."}
    assert not session.complete
    with pytest.raises(RecordingError, match=r"session_002\.mcap is not an MCAP file"):
        open_session(paths[1])


@pytest.mark.parametrize("content", [b"", bytes(4096)])
def test_the_last_part_is_missed_when_it_cannot_be_read(write_parts, content):
    paths = write_parts()
    for path in paths[1:]:
        path.write_bytes(content)
    session = open_session(paths[0])
    assert session.paths == paths[:1]
    assert session.absent_parts == [2, 3]
    assert list(session.unreadable_parts) == [2, 3]
    assert str(paths[2]) in session.unreadable_parts[3]
    assert not session.complete


def test_behind_the_last_words_of_a_recorder_no_part_is_missed(write_parts, tmp_path):
    paths = write_parts(last_words={"recorder": {}})
    (tmp_path / "session_004.mcap").touch()
    session = open_session(paths[0])
    assert session.paths == paths
    assert session.complete
    assert not session.absent_parts


def test_a_session_in_one_file_misses_no_part(write_parts, tmp_path):
    paths = write_parts(name="take_001.mcap", limits=None)
    (tmp_path / "take_002.mcap").touch()
    assert paths == [tmp_path / "take_001.mcap"]
    assert open_session(paths[0]).complete


def test_a_broken_file_named_like_a_part_does_not_spoil_the_others(write_parts, tmp_path):
    paths = write_parts()
    (tmp_path / "session_2024.mcap").touch()
    assert open_session(paths[0]).paths == paths
    with pytest.raises(RecordingError, match="is empty"):
        open_session(tmp_path / "session_2024.mcap")
