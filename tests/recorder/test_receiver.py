import ctypes
import os
import signal
import threading
import time

import pytest

from g1stream import child_process
from g1stream.config import Config
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, LowCmd, LowState
from g1stream.errors import RecordingError
from g1stream.recorder import receiver as module
from g1stream.recorder.receiver import SampleReceiver
from g1stream.recorder.recorder import Recorder
from g1stream.robot.model import G1
from g1stream.session.writer import SessionWriter
from g1stream.view.pipeline import MessagePipeline


@pytest.fixture
def receiver(domain_id):
    with SampleReceiver(Config(dds={"domain": domain_id})) as receiver:
        receiver.wait_until_ready()
        yield receiver


@pytest.fixture
def recorder(receiver, participant, tmp_path):
    with SessionWriter(tmp_path / "s.mcap") as writer:
        yield Recorder(receiver, participant, writer, MessagePipeline(G1.load()))


@pytest.fixture
def writer(participant, receiver, until):
    """A writer of LowState that the receiver's reader has matched, too."""
    writer = RawWriter(participant, LOWSTATE, 64)

    def matched():
        receiver.drain()
        return writer.matched and receiver.counts.matched[LOWSTATE.name]

    until(matched, "the receiver's reader")
    return writer


def numbered(writer, numbers):
    """Publish LowStates with these ticks, and return their bytes."""
    state, sent = LowState(), []
    for number in numbers:
        state.tick[()] = number
        sent.append(state.seal())
        writer.write(sent[-1], time.time_ns())
        time.sleep(0.0002)
    return sent


def waiting(receiver):
    """How many samples wait to be drained."""
    data, at, count = os.pread(receiver._file, 1 << 24, receiver._read), 0, 0
    while at + module._HEADER.size <= len(data):
        size, number, *_ = module._HEADER.unpack_from(data, at)
        at += module._HEADER.size + size
        count += number != module._STATUS and at <= len(data)
    return count


def drain_all(receiver):
    data, log_times, publish_times = [], [], []
    while batches := receiver.drain():
        batch = batches[LOWSTATE.name]
        data += batch.data
        log_times += batch.log_times
        publish_times += batch.publish_times
    return data, log_times, publish_times


def test_samples_wait_for_whoever_drains_them_and_their_memory_is_given_back(
    receiver, writer, until, monkeypatch
):
    """Their log times are those of the arrival."""
    monkeypatch.setattr(module, "_BLOCK", 2**20)  # several of them
    before = time.time_ns()
    sent = numbered(writer, range(1500))
    until(lambda: waiting(receiver) == 1500, "samples")
    receiver.stop()
    after = time.time_ns()
    held = os.fstat(receiver._file).st_blocks * 512
    data, log_times, publish_times = drain_all(receiver)
    assert data == sent
    assert log_times == sorted(log_times)
    assert before < log_times[0] <= log_times[-1] < after
    assert all(p <= logged for p, logged in zip(publish_times, log_times, strict=True))
    assert receiver.counts.matched[LOWSTATE.name] == 1
    assert receiver.counts.lost[LOWSTATE.name] == 0
    assert os.fstat(receiver._file).st_blocks * 512 < held / 2


def test_samples_without_room_are_counted_as_lost(participant, monkeypatch, until):
    monkeypatch.setattr(module, "_MOST_BYTES", 0)
    file = os.memfd_create("test")
    readers = module._Readers(participant, file)
    try:
        writer = RawWriter(participant, LOWCMD, 64)
        until(lambda: writer.matched, "the reader")
        os.write(file, bytes(8192))  # what nobody has read
        writer.write(LowCmd().seal())
        readers._take()
        readers._write_status()
        status = os.pread(file, 1 << 16, 8192)[module._HEADER.size :]
        counts = module.Counts(*module.json.loads(status))
        assert counts.discarded[LOWCMD.name] == counts.lost[LOWCMD.name] == 1
        assert counts.lost[LOWSTATE.name] == 0
    finally:
        del readers
        os.close(file)


def test_a_receiver_that_is_killed_raises_once_all_samples_are_drained(receiver, writer, until):
    sent = numbered(writer, range(20))
    until(lambda: waiting(receiver) == 20, "samples")
    os.kill(receiver.pid, signal.SIGKILL)
    until(lambda: receiver._failure, "the news")
    assert receiver.drain()[LOWSTATE.name].data == sent
    with pytest.raises(RecordingError, match="SIGKILL"):
        receiver.drain()


@pytest.mark.parametrize(
    ("number", "cause"), [(signal.SIGTERM, "ended unexpectedly"), (signal.SIGSTOP, "is stopped")]
)
def test_a_receiver_that_ends_or_is_stopped_is_noticed(receiver, until, number, cause):
    until(lambda: receiver._child._beating, "a sign of life")
    os.kill(receiver.pid, number)
    until(lambda: cause in receiver._failure, "the news")
    receiver.drain()  # the status
    with pytest.raises(RecordingError, match=cause):
        receiver.drain()


def test_a_program_that_is_silent_itself_does_not_blame_its_child(receiver, until, monkeypatch):
    """As while a long computation in C holds the interpreter's lock."""
    until(lambda: receiver._child._beating, "a sign of life")
    monkeypatch.setattr(child_process, "_MAX_SILENCE", 1.0)
    for _ in range(2):
        ctypes.PyDLL(None).usleep(1_700_000)
        time.sleep(0.05)
    assert not receiver._failure


@pytest.mark.parametrize("at_the_end", [False, True])
def test_a_recording_whose_receiver_was_killed_is_not_complete(
    receiver, recorder, writer, until, at_the_end
):
    ended = threading.Event()
    thread = threading.Thread(target=recorder.run, args=(ended.is_set,))
    thread.start()
    numbered(writer, range(20))
    until(lambda: recorder.received.get("/lowstate") == 20, "the samples")
    if at_the_end:
        ended.set()
    os.kill(receiver.pid, signal.SIGKILL)
    thread.join(20)
    assert "SIGKILL" in recorder.report.stopped
    assert not recorder.report.complete
    assert recorder.report.counts["/lowstate"] == 20


def test_malformed_samples_are_counted_and_the_recording_is_not_complete(recorder, writer):
    writer.write(LowState().tobytes() + bytes(8))
    report = recorder.run(lambda: True)
    assert report.malformed == {"/lowstate": 1}
    assert not report.complete
