"""What is read is what was on the wire, bit for bit, whatever else is asked of the session."""

import numpy as np
import pytest

from g1stream.dds.topics import LOWCMD, LOWSTATE, REFERENCE, SECONDARY_IMU, SPORTMODESTATE
from g1stream.errors import RecordingError
from g1stream.session.session import open_session
from g1stream.session.streams import STREAMS

T0 = 1_700_000_000_000_000_000
STEP = 70_000_000
DELAY = 123_456
TOPICS = {
    "/lowcmd": LOWCMD,
    "/lowstate": LOWSTATE,
    "/reference": REFERENCE,
    "/sportmodestate": SPORTMODESTATE,
    "/secondary_imu": SECONDARY_IMU,
}


@pytest.fixture
def sent(make_sample, on_the_wire):
    return {
        name: [on_the_wire(make_sample(topic)) for _ in range(17)] for name, topic in TOPICS.items()
    }


def test_the_bytes_come_back(sent, write_session):
    session = open_session(write_session(*sent.items()))
    for topic, samples in sent.items():
        assert list(session.replay_bytes(topic)) == samples
    assert list(session.replay_bytes()) == sent["/lowcmd"]


def test_messages_carry_both_times(sent, write_session):
    session = open_session(write_session(*sent.items()))
    messages = list(session.messages("/lowcmd"))
    assert [message.publish_time for message in messages] == [T0 + i * STEP for i in range(17)]
    assert all(message.log_time - message.publish_time == DELAY for message in messages)


def test_every_topic_has_its_times(sent, write_session):
    times = open_session(write_session(*sent.items())).times
    assert list(times) == sorted([*TOPICS, "/log"])
    for topic in TOPICS:
        np.testing.assert_array_equal(times[topic].publish_time, T0 + STEP * np.arange(17))
        np.testing.assert_array_equal(times[topic].log_time, times[topic].publish_time + DELAY)


def test_a_stream_is_read_once_and_alone(sent, write_session):
    path = write_session(*sent.items())
    session = open_session(path)
    q = session.measured.q
    path.unlink()
    assert session.measured.q is q
    assert session.measured.dq.shape == (17, 29)
    with pytest.raises(RecordingError, match="cannot be read"):
        _ = session.command.q


def test_the_imu_in_the_torso(make_sample, on_the_wire, write_session, sent):
    imus = [make_sample(SECONDARY_IMU) for _ in range(5)]
    with_imu = [("/lowcmd", sent["/lowcmd"]), ("/secondary_imu", [on_the_wire(i) for i in imus])]
    imu = open_session(write_session(*with_imu)).torso_imu
    np.testing.assert_array_equal(imu.imu_quat_wxyz, [i.quaternion for i in imus])
    np.testing.assert_array_equal(imu.gyroscope, [i.gyroscope for i in imus])
    np.testing.assert_array_equal(imu.accelerometer, [i.accelerometer for i in imus])
    without = open_session(write_session(("/lowcmd", sent["/lowcmd"]), name="without.mcap"))
    assert without.torso_imu is None


def test_a_topic_that_is_not_there(sent, write_session):
    session = open_session(write_session(("/lowcmd", sent["/lowcmd"])))
    with pytest.raises(RecordingError, match="/lowstate"):
        next(session.replay_bytes("/lowstate"))


def test_every_dds_topic_of_a_session_has_a_stream():
    assert STREAMS.keys() == TOPICS.keys()
    assert {topic: kind.source for topic, kind in STREAMS.items()} == TOPICS
