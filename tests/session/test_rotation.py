"""A session in parts, each read with the stock reader."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.reader import make_reader

from g1stream.errors import RecordingError
from g1stream.session.file_names import parts_of
from g1stream.session.metadata import metadata_from_strings
from g1stream.session.rotation import Limits, PartedWriter

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


def preface(writer):
    writer.add_metadata({"host": "here"})
    writer.attach("robot.urdf", "application/xml", b"<robot/>", T0)
    writer.write("/robot_description", b"once", T0, T0)


def record(writer, seconds, noise=b""):
    """100 LowCmds a second, handed over ten times a second."""
    for start in range(0, round(seconds * 1000), 100):
        times = T0 + (start + 10 * np.arange(10)) * MS
        writer.write_batch("/lowcmd", [noise or bytes(8)] * 10, times, times)
        writer.flush_if_due(int(times[-1]))


def read(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = [(c.topic, m) for _, c, m in reader.iter_messages()]
        metadata = {}
        for one in reader.iter_metadata():
            metadata |= metadata_from_strings(one.metadata)
        attached = [one.name for one in reader.iter_attachments()]
    return messages, metadata, attached


def test_without_limits_there_is_one_file_of_the_name_given(tmp_path):
    with PartedWriter(tmp_path / "s.mcap", preface) as writer:
        record(writer, 3)
    assert writer.paths == [tmp_path / "s.mcap"]
    assert read(writer.paths[0])[1] == {"session_id": writer.session_id, "host": "here"}
    assert writer.counts == {"/robot_description": 1, "/lowcmd": 300}
    assert parts_of(tmp_path / "s.mcap") == writer.paths


def test_parts_end_after_their_duration_and_nothing_is_lost_between(tmp_path):
    with PartedWriter(tmp_path / "s.mcap", preface, Limits(duration=10**9)) as writer:
        record(writer, 3.5)
    assert [p.name for p in writer.paths] == [
        "s_001.mcap",
        "s_002.mcap",
        "s_003.mcap",
        "s_004.mcap",
    ]
    times, sequences = [], []
    for number, path in enumerate(writer.paths, start=1):
        messages, metadata, attached = read(path)
        assert metadata == {"session_id": writer.session_id, "part": number, "host": "here"}
        assert attached == ["robot.urdf"]
        assert [t for t, _ in messages].count("/robot_description") == 1
        of_part = [m for t, m in messages if t == "/lowcmd"]
        span = of_part[-1].log_time - of_part[0].log_time
        assert span <= 1_100 * MS
        times += [m.log_time for m in of_part]
        sequences += [m.sequence for m in of_part]
    assert times == [T0 + 10 * MS * i for i in range(350)]
    assert sequences == list(range(1, 351))
    assert writer.counts["/lowcmd"] == 350


def test_parts_end_with_the_chunk_that_reaches_their_size(tmp_path):
    noise = np.random.default_rng(1).bytes(10_000)
    with PartedWriter(tmp_path / "s.mcap", preface, Limits(size=20_000)) as writer:
        record(writer, 4, noise)
    sizes = [path.stat().st_size for path in writer.paths]
    assert len(sizes) > 2
    assert all(20_000 <= size < 60_000 for size in sizes[:-1])
    assert sum(len(read(path)[0]) for path in writer.paths) == 400 + len(sizes)


def test_a_clock_set_back_does_not_keep_a_part_open(tmp_path):
    with PartedWriter(tmp_path / "s.mcap", preface, Limits(duration=10**9)) as writer:
        record(writer, 0.5)
        writer.flush_if_due(T0 - 3600 * 10**9)
    assert len(writer.paths) == 2


def test_a_preface_that_fails_leaves_no_open_file(tmp_path):
    def broken(writer):
        raise RecordingError("No.", "Never.")

    with pytest.raises(RecordingError, match="No"):
        PartedWriter(tmp_path / "s.mcap", broken)
    assert read(tmp_path / "s.mcap")[0] == []


@pytest.mark.parametrize("where", ["before", "after"])
def test_without_a_next_part_the_last_words_go_into_the_old(tmp_path, where):
    prefaces = []

    def once(writer):
        if where == "after" or not prefaces:
            preface(writer)
        if prefaces:
            raise RecordingError("The disk is full.", "Make room.")
        prefaces.append(writer.path)

    with PartedWriter(tmp_path / "s.mcap", once, Limits(duration=10**9)) as writer:
        with pytest.raises(RecordingError, match="full"):
            record(writer, 2)
        writer.add_metadata({"last": "words"})
    assert writer.paths == [tmp_path / "s_001.mcap"] == sorted(tmp_path.iterdir())
    messages, metadata, _ = read(writer.paths[0])
    assert metadata["last"] == "words"
    assert writer.counts == {"/robot_description": 1, "/lowcmd": len(messages) - 1}


def test_what_every_part_carries_does_not_fill_a_part(tmp_path):
    def large(writer):
        writer.attach("robot.urdf", "application/xml", bytes(100_000), T0)

    noise = np.random.default_rng(1).bytes(10_000)
    with PartedWriter(tmp_path / "s.mcap", large, Limits(size=50_000)) as writer:
        record(writer, 0.2)
        assert len(writer.paths) == 1
        record(writer, 2, noise)
    assert len(writer.paths) > 1
