import numpy as np
import pytest

from g1stream.app.session import Session
from g1stream.dds.messages import LOWCMD, LOWSTATE
from g1stream.session.source import MemorySource

T0 = 1_700_000_000_000_000_000
TIMES = T0 + 2_000_000 * np.arange(5)


@pytest.fixture
def sent(make_sample):
    topics = {"/lowcmd": LOWCMD, "/lowstate": LOWSTATE}
    return {name: [make_sample(topic).serialize() for _ in TIMES] for name, topic in topics.items()}


def test_messages_metadata_and_attachments_come_back(sent):
    source = MemorySource("rollout")
    source.write_batch("/lowcmd", sent["/lowcmd"], TIMES + 9, TIMES)
    for time, data in zip(TIMES.tolist(), sent["/lowstate"], strict=True):
        source.write("/lowstate", data, time + 9, time)
    source.add_metadata({"gains": {"kp": np.array([1.0, 2.0])}, "at_end": False})
    source.add_metadata({"at_end": True})
    source.attach("robot.urdf", "application/xml", b"<robot/>", T0)
    session = Session(source)
    assert session.complete
    assert session.paths == []
    assert str(session.path) == "rollout"
    assert session.topics == {"/lowcmd": 5, "/lowstate": 5}
    assert session.metadata == {"gains": {"kp": [1.0, 2.0]}, "at_end": True}
    assert session.attachments == {"robot.urdf": b"<robot/>"}
    assert session.measured.q.shape == (5, 29)
    np.testing.assert_array_equal(session.command.log_time, TIMES + 9)
    np.testing.assert_array_equal(session.command.publish_time, TIMES)
    for topic, samples in sent.items():
        assert list(session.replay_bytes(topic)) == samples
