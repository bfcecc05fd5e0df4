"""What becomes of a recording's file that the stream could not begin, or never heard anything."""

from __future__ import annotations

import pytest

from g1stream.cli.main import main
from g1stream.config import Config, RecordConfig
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.topics import LOWSTATE
from g1stream.errors import RecordingError
from g1stream.programs import stream as program
from g1stream.programs.recorder_child import discard_if_empty, refuse_path
from g1stream.programs.stream import stream
from g1stream.session.summary import RecorderSummary

SPLIT = RecordConfig(split_size=1.0)


@pytest.fixture
def config(domain_id):
    return Config.model_validate({"dds": {"domain": domain_id}, "stream": {"wait": 1.0}})


def test_a_path_is_refused_before_anything_starts(tmp_path, monkeypatch):
    monkeypatch.setattr(program, "Participant", lambda *_: pytest.fail("it is on DDS already"))
    with pytest.raises(RecordingError, match=r"The directory .*no does not exist"):
        stream("demo", record=tmp_path / "no" / "s.mcap")


@pytest.mark.parametrize(
    ("settings", "name", "there", "force", "refused"),
    [
        (RecordConfig(), "s.mcap", "s.mcap", False, True),
        (RecordConfig(), "s.mcap", "s.mcap", True, False),
        (RecordConfig(auto_name=True), "s.mcap", "s.mcap", False, False),
        (SPLIT, "s.mcap", "s.mcap", False, False),
        (SPLIT, "s.mcap", "s", False, True),
        (SPLIT, "s.mcap", "s", True, True),
        (RecordConfig(), "", "s.mcap", True, True),
    ],
)
def test_what_is_there_is_left_as_it_is(tmp_path, settings, name, there, force, refused):
    (tmp_path / there).write_bytes(b"precious")
    if refused:
        with pytest.raises(RecordingError):
            refuse_path(tmp_path / name, settings, force)
    else:
        refuse_path(tmp_path / name, settings, force)
    assert [*tmp_path.iterdir()] == [tmp_path / there]
    assert (tmp_path / there).read_bytes() == b"precious"


def test_a_file_in_which_there_is_nothing_does_not_stand_in_the_way(
    domain_id, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("g1stream.cli.stream.on_signals", lambda stop: None)
    short, path = tmp_path / "short.toml", tmp_path / "s.mcap"
    short.write_text("[stream]\nwait = 1.0\n")
    command = ["stream", "demo", "--domain", str(domain_id), "--config", str(short)]
    assert main([*command, "--record", str(path)]) == 1
    assert f"{path}, removed" in " ".join(capsys.readouterr().out.split())
    assert not path.exists()


@pytest.mark.parametrize("force", [False, True])
def test_a_name_that_no_file_can_have_is_refused_in_a_sentence(tmp_path, force):
    with pytest.raises(RecordingError, match="File name too long"):
        refuse_path(tmp_path / ("n" * 300), RecordConfig(), force)
    with pytest.raises(RecordingError, match="is a directory"):
        refuse_path(tmp_path, RecordConfig(), force)


def test_a_link_that_leads_nowhere_stays(tmp_path):
    link = tmp_path / "s.mcap"
    link.symlink_to(tmp_path / "elsewhere.mcap")
    refuse_path(link, RecordConfig(), True)
    assert link.is_symlink()
    assert not link.exists()


def test_a_file_that_was_there_before_is_not_removed(config, tmp_path):
    path = tmp_path / "s.mcap"
    path.write_bytes(b"not so precious")
    summary = stream("demo", config, record=path, force=True)
    assert summary.recorder.removed is False
    assert path.read_bytes()[:5] == b"\x89MCAP"  # it was to be replaced, and has been


def test_what_was_received_is_kept(config, domain_id, tmp_path):
    with Participant(domain_id, "lo") as peer:
        RawWriter(peer, LOWSTATE)
        summary = stream("demo", config, record=tmp_path / "s.mcap")
    assert summary.recorder.removed is True  # it said nothing
    heard = summary.recorder.model_copy(update={"counts": {"/log": 3, "/secondary_imu": 1}})
    (tmp_path / "s.mcap").touch()
    assert not discard_if_empty(heard, set())
    assert (tmp_path / "s.mcap").exists()


def test_of_a_recorder_that_died_nothing_is_known(tmp_path):
    path = tmp_path / "s.mcap"
    path.touch()
    assert not discard_if_empty(RecorderSummary(paths=[str(path)], stopped="it died"), set())
    assert path.exists()
