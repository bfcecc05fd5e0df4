"""Session files made of samples whose figures are known."""

from io import BytesIO

import pytest
from mcap.reader import make_reader

from g1stream.session.format import encode_log
from g1stream.session.writer import SessionWriter

T0 = 1_700_000_000_000_000_000
STEP = 70_000_000
DELAY = 123_456


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


def stock_reader(path, **options):
    """The stock reader of a file, which need not stay open."""
    return make_reader(BytesIO(path.read_bytes()), **options)
