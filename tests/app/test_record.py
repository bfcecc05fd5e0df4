import logging
import threading
import time

import pytest

from g1stream.app import record as program
from g1stream.app.session import open_session
from g1stream.cli.command import EXIT_STOPPED, exit_code
from g1stream.config import Config
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.log_handler import LogHandler
from g1stream.dds.messages import LOG, LOWCMD, LOWSTATE, REFERENCE, LowCmd, LowState
from g1stream.errors import ConfigError, WireError
from g1stream.recorder import recorder
from g1stream.robot.model import G1
from g1stream.session.records import MotionInfo, RecorderSummary, SessionInfo
from g1stream.session.writer import SessionWriter

SESSION = SessionInfo(motion=MotionInfo(name="walk"))


@pytest.fixture
def config(domain_id):
    return Config.model_validate({"dds": {"domain": domain_id, "interface": "lo"}})


def test_a_missing_stream_is_an_error(config, tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "_MATCH_TIMEOUT", 0.2)
    ready = threading.Event()
    with pytest.raises(WireError, match="rt/lowcmd"):
        program.record(tmp_path / "s.mcap", config, session=SESSION, on_ready=ready.set)
    assert not ready.is_set()
    assert not (tmp_path / "s.mcap").exists()


def test_why_it_was_stopped_is_in_the_file(tmp_path):
    path = tmp_path / "s.mcap"
    with SessionWriter(path) as writer:
        writer.write("/lowstate", LowState().seal(), 2, 1)
        program._close(writer, RecorderSummary(), {"stopped": "SIGTERM"})
    assert open_session(path).summary().recorder.stopped == "SIGTERM"


@pytest.mark.parametrize("before", [False, True])
def test_a_recording_without_a_sample_is_removed_and_an_older_one_is_kept(config, tmp_path, before):
    path = tmp_path / "s.mcap"
    if before:
        with SessionWriter(path) as writer:
            writer.write("/lowstate", LowState().tobytes(), 1, 1)
    there = sorted(tmp_path.rglob("*"))
    content = path.read_bytes() if before else b""
    summary = program.record(path, config, force=True, should_stop=lambda: True)
    assert summary.recorder.removed
    assert summary.recorder.first_ns is None
    assert summary.problems
    assert exit_code(summary) == EXIT_STOPPED
    assert sorted(tmp_path.rglob("*")) == there
    assert not before or path.read_bytes() == content


def test_samples_are_received_while_waiting_for_the_stream(config, beside, tmp_path, until):
    """Each when it comes: ten that come one by one do not share a log time."""
    path, recorders = tmp_path / "s.mcap", []
    options = {"session": SESSION, "on_recorder": recorders.append}
    with (
        Participant(config.dds.domain, "lo") as participant,
        beside(program.record, path, config, **options) as recording,
    ):
        states = RawWriter(participant, LOWSTATE, 20)
        until(
            lambda: recorders and recorders[0]._receiver.counts.matched[LOWSTATE.name],
            "the recorder's reader",
        )
        for _ in range(10):
            states.write(LowState().tobytes())
            time.sleep(0.05)
        assert not recording.ready.is_set()
        RawWriter(participant, LOWCMD)
        RawWriter(participant, REFERENCE)
        until(recording.ready.is_set, "the recorder")
    assert len(set(open_session(path).measured.log_time.tolist())) == 10


@pytest.mark.parametrize("goes_on", [False, True])
def test_the_recorder_and_its_file_tell_the_same_problems(
    config, beside, tmp_path, until, monkeypatch, goes_on
):
    """That commands have stopped is one where they come again, and none at the program's end."""
    path, logger = tmp_path / "s.mcap", logging.getLogger("g1stream.test_record")
    with (
        Participant(config.dds.domain, "lo") as participant,
        beside(program.record, path, config) as recording,
    ):
        states, commands, log = (RawWriter(participant, t, 20) for t in (LOWSTATE, LOWCMD, LOG))
        monkeypatch.setattr(logger, "handlers", [LogHandler("sim", log.write)])
        until(recording.ready.is_set, "the recorder")
        until(lambda: states.matched and commands.matched and log.matched, "the recorder")
        for _ in range(3):
            states.write(LowState().seal())
            commands.write(LowCmd().seal())
            time.sleep(0.02)
        logger.warning("LowCmd timeout: the motors only damp")
        logger.warning("3 of 29 motors are hot")
        for _ in range(3 * goes_on):
            time.sleep(0.02)
            commands.write(LowCmd().seal())
        time.sleep(0.3)
    told, found = recording.result, open_session(path).summary()
    timeout = ["sim: LowCmd timeout: the motors only damp"] * goes_on
    for summary in (told, found):
        problems = [problem for problem in summary.problems if "sim:" in problem]
        assert problems == [*timeout, "sim: 3 of 29 motors are hot"]
    assert found.recorder.warnings == told.recorder.warnings


def test_a_robot_that_cannot_be_shown_leaves_no_file(config, tmp_path):
    urdf = tmp_path / "g1.urdf"
    urdf.write_text(G1.load().urdf.replace('"head_link"', '"world"'))
    config = config.model_copy(update={"robot": str(urdf)})
    with pytest.raises(ConfigError, match="world"):
        program.record(tmp_path / "s.mcap", config, should_stop=lambda: True)
    assert not (tmp_path / "s.mcap").exists()
