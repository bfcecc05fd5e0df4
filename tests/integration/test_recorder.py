"""The recorder on real DDS, its file read with the stock reader."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import get_args

import numpy as np
import pytest
from mcap.reader import make_reader

from g1stream.app.session import open_session
from g1stream.config import Config, RecordConfig
from g1stream.dds.discovery import AnnouncedBridge
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, REFERENCE, SPORTMODESTATE, LowState, Reference
from g1stream.recorder.diagnostics import ClockReading, read_clocks
from g1stream.recorder.receiver import SampleReceiver
from g1stream.recorder.recorder import Recorder
from g1stream.robot.model import G1
from g1stream.session.records import MeasuredTf
from g1stream.session.writer import SessionWriter
from g1stream.types import ChannelSet
from g1stream.view.pipeline import MessagePipeline
from threads import in_thread

S = 1_000_000_000


BRIDGE = AnnouncedBridge("bolted", rate=1000.0).user_data  # whose ticks count LowStates


class Publisher:
    """Publishes numbered samples of some topics and remembers their bytes."""

    def __init__(self, participant, *topics, user_data=BRIDGE):
        self.sent = {topic.name: [] for topic in topics}
        self._made = [
            (topic, RawWriter(participant, topic, 100, user_data=user_data), topic.message())
            for topic in topics
        ]

    def matched(self):
        return all(writer.matched for _, writer, _ in self._made)

    def publish(self, tick, stamp=None):
        stamp = stamp or time.time_ns()
        for topic, writer, message in self._made:
            message.payload[-8:] = tick % 251
            if isinstance(message, (LowState, Reference)):
                message.tick[()] = tick
            if isinstance(message, Reference):
                message.root_quat_wxyz[:] = 1, 0, 0, 0
            if isinstance(message, LowState):
                message.quaternion[:] = 1, 0, 0, 0
            self.sent[topic.name].append(message.tobytes())
            writer.write(message.tobytes(), stamp)

    def run(self, ticks, rate=500, ahead_ns=0):
        for tick in ticks:
            self.publish(tick, time.time_ns() + ahead_ns)
            time.sleep(1 / rate)


@contextmanager
def recording(domain_id, path, channels="standard", **options):
    """A recorder in a thread of its own; it has stopped when this is left."""
    with (
        SampleReceiver(Config(dds={"domain": domain_id})) as receiver,
        Participant(domain_id, "lo") as participant,
        SessionWriter(path) as writer,
    ):
        pipeline = MessagePipeline(G1.load(), RecordConfig(channels=channels))
        recorder = Recorder(receiver, participant, writer, pipeline, **options)
        with in_thread(lambda stop: recorder.run(stop.is_set)):
            yield recorder


@pytest.fixture
def record(domain_id, tmp_path, until):
    """Runs `publish(publisher)` under a recorder; returns its report and the file."""

    def run(topics, publish, **options):
        path = tmp_path / "session.mcap"
        with (
            Participant(domain_id, "lo") as participant,
            recording(domain_id, path, **options) as recorder,
        ):
            publisher = Publisher(participant, *topics)
            receiver = recorder._receiver
            until(
                lambda: (
                    publisher.matched() and all(receiver.counts.matched[one.name] for one in topics)
                ),
                "the recorder's readers",
            )
            publish(publisher)
        return recorder.report, path, publisher

    return run


def data_of(path, topic):
    with path.open("rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages(topics=[topic])
        return [message.data for _, _, message in found]


def logged(path):
    return [event.text for event in open_session(path).log]


@pytest.mark.parametrize("channels", get_args(ChannelSet))
def test_samples_are_recorded_byte_for_byte(record, channels):
    report, path, publisher = record(
        (LOWCMD, LOWSTATE, REFERENCE), lambda p: p.run(range(500)), channels=channels
    )
    assert data_of(path, "/lowcmd") == publisher.sent[LOWCMD.name]
    assert data_of(path, "/lowstate") == publisher.sent[LOWSTATE.name]
    assert data_of(path, "/reference") == publisher.sent[REFERENCE.name]
    assert report.complete
    assert not any(report.lost.values())


def test_derived_messages_are_recorded(record):
    report, path, _ = record(
        (LOWCMD, LOWSTATE, REFERENCE), lambda p: p.run(range(300)), channels="full"
    )
    for topic in ("/reference/joint_states", "/measured/joint_states"):
        assert report.counts[topic] == 300
    # A state and the reference of its very moment bear the same stamp here.
    assert report.counts["/tracking_error/joint_states"] == 300
    assert report.counts["/tf"] > 40
    assert report.counts["/measured/tf"] > 40
    assert report.measured_tf == MeasuredTf(yaw_offset_rad=0.0, position_from="reference")
    assert any("yaw is aligned" in text for text in logged(path))
    times = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            times.setdefault(channel.topic, []).append(message.log_time)
    for topic, of_topic in times.items():
        assert of_topic == sorted(of_topic), topic


def test_gaps_in_the_ticks_are_logged_and_written_into_the_file(record, caplog):
    report, path, _ = record((LOWSTATE,), lambda p: p.run([*range(100), *range(107, 1000)]))
    assert report.lost["/lowstate"] == 7
    assert not report.complete
    (event,) = open_session(path).log
    assert (event.level, event.name) == ("WARNING", "record")
    assert "7" in event.text
    assert "/lowstate" in event.text
    assert [record.getMessage() for record in caplog.records] == [event.text]


def test_a_clock_step_is_logged_and_log_times_are_not_corrected(record):
    begun = []

    def clocks():
        reading = read_clocks()
        begun.append(reading.monotonic)
        set_forward = 3600 * S if reading.monotonic - begun[0] > S else 0
        return ClockReading(reading.realtime + set_forward, reading.monotonic)

    report, path, _ = record((LOWSTATE,), lambda p: p.run(range(1000)), clocks=clocks)
    (step,) = report.clock_steps
    assert step.step_ns == pytest.approx(3600 * S, abs=50_000_000)
    assert any("CLOCK_REALTIME was set by +3600" in text for text in logged(path))
    session = open_session(path)
    assert session.clock_steps == [step]
    assert np.ptp(session.measured.log_time) < 100 * S


def test_a_publisher_whose_clock_is_ahead_is_logged_once(record):
    topics = LOWSTATE, SPORTMODESTATE
    report, path, _ = record(topics, lambda p: p.run(range(1000), ahead_ns=5 * S))
    assert report.delays["/lowstate"].median_ns == pytest.approx(-5 * S, abs=50_000_000)
    (text,) = [text for text in logged(path) if "clocks differ" in text]
    assert "state from" in text
    assert "-4.99" in text or "-5.00" in text


def test_a_publisher_that_restarts_with_another_clock_is_logged(record, domain_id, until):
    def publish(first):
        first.run(range(700))
        with Participant(domain_id, "lo") as participant:
            second = Publisher(participant, LOWSTATE)
            until(second.matched, "the recorder's reader")
            second.run(range(700, 1400), ahead_ns=5 * S)

    report, path, _ = record((LOWSTATE,), publish)
    (text,) = [text for text in logged(path) if "clocks differ" in text]
    assert "-4.99" in text or "-5.00" in text
    assert report.delays["/lowstate"].median_ns == pytest.approx(-5 * S, abs=50_000_000)
