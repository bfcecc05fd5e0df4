import logging
from pathlib import Path

import pytest

from g1stream.app import stream as program
from g1stream.app.stream import stream
from g1stream.child_process import Child, ChildError
from g1stream.config import Config, DdsConfig
from g1stream.control.sources import HeldTorques
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, ODOMMODESTATE, SECONDARY_IMU, SecondaryImu, SportModeState
from g1stream.errors import MotionError, RecordingError
from g1stream.events import handled_by
from g1stream.types import Phase


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


def test_a_source_hears_the_newest_sample_of_a_topic(domain_id, until):
    sent = SportModeState()
    with Participant(domain_id, "lo") as ours, Participant(domain_id, "lo") as robot:
        newest, writer = program._newest(ours, ODOMMODESTATE), RawWriter(robot, ODOMMODESTATE)
        until(writer.subscribers, "matched")
        for place in (1.0, 2.0):
            sent.position[:] = place
            writer.write(sent.tobytes(), 1)
        heard = []
        until(lambda: heard.append(newest()) or heard[-1] == sent.tobytes(), "received")
        assert newest() is None


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


@pytest.mark.parametrize("path", ["there", "no/s.mcap"])
def test_an_output_path_is_refused_before_anything_starts(tmp_path, monkeypatch, path):
    monkeypatch.setattr(program, "Participant", lambda *_: pytest.fail("a participant is created"))
    (tmp_path / "there").write_bytes(b"precious")
    with pytest.raises(RecordingError):
        stream("demo", record=tmp_path / path)
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


class Kept(logging.Handler):
    """Keeps the records that it handles."""

    def __init__(self):
        super().__init__()
        self.records = []

    def emit(self, record):
        self.records.append(record)


@pytest.fixture
def raising(monkeypatch):
    """Let the source raise an error in PLAY."""
    command = HeldTorques.command

    def make(error):
        def fail(source, moment):
            if moment.phase is Phase.PLAY:
                raise error
            return command(source, moment)

        monkeypatch.setattr(HeldTorques, "command", fail)

    return make


QUICK = {"ramp": 0.3, "duration": 0.5, "hold": 0.1, "damp": 0.5}


@pytest.mark.parametrize(
    "error", [OSError(28, "No space"), KeyError("knee"), MotionError("No.", "Yes.")]
)
@pytest.mark.parametrize("recorded", [False, True])
def test_an_error_after_the_first_command_is_the_reason(
    bridge, config, raising, tmp_path, error, recorded
):
    raising(error)
    config = config.model_copy(update={"stream": config.stream.model_copy(update=QUICK)})
    kept = Kept()
    with bridge(), handled_by(kept):
        summary = stream("demo", config, record=tmp_path / "s.mcap" if recorded else None)
    reason = summary.termination.reason
    assert reason.startswith("No. Yes" if isinstance(error, MotionError) else repr(error)[:4])
    assert sum(reason in problem for problem in summary.problems) == 1
    assert summary.stream.commands > 100
    if recorded:
        assert summary.phases[-1].phase is Phase.DAMP
    places = [r.getMessage() for r in kept.records if "test_stream.py" in r.getMessage()]
    assert len(places) == (not isinstance(error, MotionError))  # a bug's place


def test_an_error_before_the_first_command_is_raised(bridge, config, monkeypatch):
    def fail(*_):
        raise KeyError("knee")

    monkeypatch.setattr(HeldTorques, "begin", fail)
    with bridge(), pytest.raises(KeyError):
        stream("demo", config)


@pytest.mark.parametrize(("code", "expected"), [(0, 1), (None, 1), (3, 3)])
def test_an_exit_in_the_loop_is_no_success(bridge, config, raising, code, expected):
    raising(SystemExit(code))
    config = config.model_copy(update={"stream": config.stream.model_copy(update=QUICK)})
    with bridge(), pytest.raises(SystemExit) as ended:
        stream("demo", config)
    assert ended.value.code == expected


def test_a_recording_that_cannot_be_read_leaves_the_counters(bridge, config, tmp_path, monkeypatch):
    finish = Child.finish

    def damage(child, *arguments, **options):
        result = finish(child, *arguments, **options)
        if child.name == "record":
            (tmp_path / "s.mcap").write_bytes(b"damaged")
        return result

    monkeypatch.setattr(Child, "finish", damage)
    config = config.model_copy(update={"stream": config.stream.model_copy(update=QUICK)})
    with bridge():
        summary = stream("demo", config, record=tmp_path / "s.mcap")
    assert summary.termination.reason == ""
    assert summary.tracking.compared_states > 100
