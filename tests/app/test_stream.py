from pathlib import Path

import pytest

from g1stream.app import stream as program
from g1stream.app.stream import stream
from g1stream.child_process import Child, ChildError
from g1stream.config import Config, DdsConfig
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, SECONDARY_IMU, SecondaryImu
from g1stream.errors import MotionError, RecordingError


@pytest.fixture
def config(domain_id):
    return Config.model_validate({"dds": {"domain": domain_id}, "stream": {"wait": 1.0}})


def test_where_nobody_is_it_says_where_to_look(claim_domain, config, monkeypatch, stranger):
    """A robot in another domain is found, as by the doctor."""
    monkeypatch.setattr("g1stream.doctor.inspection._DISCOVERY_S", 2.0)  # of a busy machine
    here, there = claim_domain(), claim_domain()
    stranger(
        "from g1stream.dds.domain import Participant\n"
        "from g1stream.dds.endpoints import RawWriter\n"
        "from g1stream.dds.messages import LOWSTATE\n"
        f"writer = RawWriter(Participant({there}, 'lo'), LOWSTATE)"
    )
    summary = stream("demo", config.model_copy(update={"dds": DdsConfig(domain=here)}))
    assert summary.stream.commands == 0
    assert summary.tracking is None
    remedies = [one.remedy for one in summary.stream.findings if one.about == "domain"]
    assert f"Use --domain {there}." in remedies


def test_a_motion_that_is_refused_leaves_no_process(domain_id, config, tmp_path):
    """The guard has been started by then."""
    with Participant(domain_id, "lo") as peer:
        commands = RawReader(peer, LOWCMD)
        with pytest.raises(MotionError):
            stream(tmp_path / "none.csv", config)
        assert not commands.take()
    children = [task.read_text() for task in Path("/proc/self/task").glob("*/children")]
    assert children  # the kernel tells them
    assert not any(children)


@pytest.mark.parametrize(
    ("settings", "path"),
    [({}, "there"), ({"auto_name": True}, "no/s.mcap"), ({"split_size": 1.0}, "there.mcap")],
)
def test_an_output_path_is_refused_before_anything_starts(tmp_path, monkeypatch, settings, path):
    monkeypatch.setattr(program, "Participant", lambda *_: pytest.fail("a participant is created"))
    (tmp_path / "there").write_bytes(b"precious")
    config = Config.model_validate({"record": settings})
    with pytest.raises(RecordingError):
        stream("demo", config, record=tmp_path / path)
    assert [*tmp_path.iterdir()] == [tmp_path / "there"]
    assert (tmp_path / "there").read_bytes() == b"precious"


def test_a_recorder_that_fails_is_reported_and_its_file_kept(
    config, domain_id, tmp_path, monkeypatch, publishing
):
    finish = Child.finish

    def fail(child, *arguments, **options):
        if child.name != "record":
            return finish(child, *arguments, **options)
        child.kill()
        raise ChildError("It hangs.", "")

    monkeypatch.setattr(Child, "finish", fail)
    with Participant(domain_id, "lo") as peer:
        imu = RawWriter(peer, SECONDARY_IMU)
        with publishing(lambda: imu.write(SecondaryImu().tobytes())):
            summary = stream("demo", config, record=tmp_path / "s.mcap")
    assert summary.recorder.stopped == "It hangs."
    assert not summary.recorder.removed
    assert (tmp_path / "s.mcap").exists()
