"""Session files made of samples whose figures are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from g1stream.dds.layout import members
from g1stream.recording.encode import encode_log
from g1stream.recording.writer import SessionWriter

T0 = 1_700_000_000_000_000_000
STEP = 70_000_000
DELAY = 123_456


def _filled(element: Any, rng: np.random.Generator) -> Any:
    if isinstance(element, str):
        if element.startswith("float"):
            return float(np.float32(rng.normal()))
        limits = np.iinfo("uint8" if element == "byte" else element)
        return int(rng.integers(limits.min, limits.max, endpoint=True, dtype=limits.dtype))
    values = {}
    for name, (inner, length) in members(element).items():
        made = [_filled(inner, rng) for _ in range(length or 1)]
        values[name] = made[0] if length is None else made
    return element(**values)


@pytest.fixture
def make_sample():
    """Makes instances of cyclonedds' classes with every field set to something of its own."""
    rng = np.random.default_rng(11)
    return lambda topic: _filled(topic.message.idl_type, rng)


@pytest.fixture
def on_the_wire():
    """The bytes of an instance of cyclonedds' classes as they are on the wire: padded to words."""

    def encode(sample):
        data = sample.serialize()
        return data + bytes(-len(data) % 4)

    return encode


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
