"""The thread that receives, and what becomes of a recording when it goes wrong."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawSample, RawWriter
from g1stream.dds.messages import LOWSTATE, LowState
from g1stream.errors import RecordingError
from g1stream.recorder.receiver import Receiver
from g1stream.recorder.recorder import Recorder
from g1stream.robot.model import G1
from g1stream.session.writer import SessionWriter
from g1stream.view.pipeline import MessagePipeline

T0 = 1_700_000_000_000_000_000


@pytest.fixture
def participant(domain_id):
    with Participant(domain_id, "lo") as participant:
        yield participant


@pytest.fixture
def recorder(participant, tmp_path):
    with SessionWriter(tmp_path / "s.mcap") as writer:
        yield Recorder(participant, writer, MessagePipeline(G1.load()), 0.1)


@pytest.fixture
def dying(monkeypatch):
    """Readers of LowState have one sample to give, then fail."""
    left = []
    for i in range(2):
        left.append(RawSample(LowState().tobytes()))
        left[i].sample_info = SimpleNamespace(source_timestamp=T0 + i, publication_handle=7)

    def take(reader, most=256):
        if reader.topic is not LOWSTATE:
            return []
        if not left:
            raise MemoryError("no room")
        return [left.pop(0)]

    monkeypatch.setattr(RawReader, "take", take)


def test_a_failed_receiver_raises_once_all_samples_are_drained(participant, dying):
    receiver = Receiver(participant, [LOWSTATE])
    receiver.start()
    receiver._thread.join(10)
    try:
        assert receiver.drain()[LOWSTATE.name].publish_times == [T0, T0 + 1]
        with pytest.raises(RecordingError, match="no room"):
            receiver.drain()
    finally:
        receiver.stop()


@pytest.mark.parametrize("at_once", [True, False])
def test_a_recording_whose_receiver_failed_is_not_complete(recorder, dying, at_once):
    report = recorder.run(lambda: at_once)
    assert "no room" in report.stopped
    assert not report.complete
    assert report.counts["/lowstate"] == 2


def test_malformed_samples_are_counted_and_the_recording_is_not_complete(
    recorder, participant, until
):
    writer = RawWriter(participant, LOWSTATE)
    until(lambda: writer.matched, "the recorder's reader")
    writer.write(LowState().tobytes() + bytes(8))
    report = recorder.run(lambda: True)
    assert report.malformed == {"/lowstate": 1}
    assert not report.complete
