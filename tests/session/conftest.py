"""Session files made of samples whose figures are known, and a file that our layout wrote."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from g1stream.foxglove.encoders import encode_log
from g1stream.session.chunked_file import ChunkedFile
from g1stream.session.message_records import message_records
from g1stream.session.output import Output
from g1stream.session.writer import SessionWriter

T0 = 1_700_000_000_000_000_000
STEP = 70_000_000
DELAY = 123_456


def kind(topic):
    return SimpleNamespace(
        topic=topic,
        message_encoding="cdr",
        description=f"all of {topic}",
        schema_name="Thing",
        schema_encoding="ros2msg",
        build_schema=lambda: b"int8 x",
    )


@pytest.fixture
def stamps():
    """By topic, the log times of each of its chunks; they overlap, and one goes back in time."""
    return {
        "/a": [T0 + np.arange(0, 50), T0 + np.arange(50, 90)],
        "/b": [T0 + np.arange(20, 60, 4), T0 + np.arange(100, 40, -5)],
        "/c": [T0 + np.array([7])],
    }


@pytest.fixture(params=["zstd", "lz4", "none"])
def written(request, tmp_path, stamps):
    """A file of single-channel chunks, those of the topics in turn; closed."""
    path = tmp_path / "f.mcap"
    output = Output(path, "x")
    file = ChunkedFile(output, "tests", request.param)
    file.registry.number(kind("/never"))
    counts = dict.fromkeys(stamps, 0)
    for turn in range(2):
        for topic, chunks in stamps.items():
            if turn < len(chunks):
                times = chunks[turn]
                number = file.registry.number(kind(topic))
                data = [f"{topic} {time - T0}".encode() for time in times]
                records, places = message_records(number, counts[topic] + 1, data, times, times - 3)
                file.add_chunk(number, records, times, places)
                counts[topic] += len(times)
    file.attach("a.txt", "text/plain", b"attached", T0)
    file.add_metadata("some", {"key": "value"})
    file.finish()
    output.close()
    return path


@pytest.fixture
def write_session(tmp_path):
    """Writes (topic, samples) with the times T0 + i * STEP, received DELAY later."""

    def write(*streams, name="session.mcap", close=True):
        path = tmp_path / name
        writer = SessionWriter(path)
        writer.add_metadata({"domain": 1, "versions": {"g1stream": "0.1.0"}, "at_end": False})
        writer.attach("motion.csv", "text/csv", b"Frame,X\n", T0)
        for i in range(max(len(samples) for _, samples in streams)):
            stamp = T0 + i * STEP
            for topic, samples in streams:
                if i < len(samples):
                    writer.write(topic, samples[i], stamp + DELAY, stamp)
        writer.write("/log", encode_log(T0, 3, "stream", "late by 3 ms"), T0 + 5, T0)
        if close:
            writer.add_metadata({"at_end": True})
            writer.close()
        else:
            writer.flush_if_due(T0 + 10**12)
        return path

    return write
