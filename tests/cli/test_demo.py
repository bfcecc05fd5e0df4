"""A demo of a motion of the user's own tells what `stream` tells of it."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import pytest

from g1stream.analysis.summary import Summary, Termination
from g1stream.app import demo as program
from g1stream.cli.demo import Demo, _write_page
from g1stream.errors import ConfigError, RecordingError
from g1stream.motion.readers import load_motion

OF_THE_READER = "Row 7 has a quaternion of length 0.9."


@pytest.fixture
def told(monkeypatch):
    """What happens on the way, in order; nothing is simulated or played."""
    heard = []

    class Bridge:
        def __init__(self, *_):
            pass

        def wait_until_ready(self):
            heard.append("bridge")

        def finish(self):
            pass

        def kill(self):
            pass

    def stream(motion, config, *, on_loop, **_):
        on_loop(SimpleNamespace(request_stop=None))
        return Summary(termination=Termination(reason=""))

    mine = replace(load_motion("demo"), warnings=(OF_THE_READER,))
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    monkeypatch.setattr(program, "_publishers", lambda *_: [])
    monkeypatch.setattr(program, "Child", Bridge)
    monkeypatch.setattr(program, "stream", stream)

    def load(path, *, fps, joint_order):
        heard.append(joint_order)
        return mine

    monkeypatch.setattr("g1stream.motion.readers.load_motion", load)
    monkeypatch.setattr("g1stream.cli.stream.on_signals", lambda _: nullcontext())
    monkeypatch.setattr("g1stream.cli.stream.announce_wire", lambda _: heard.append("wire"))
    monkeypatch.setattr("g1stream.cli.demo.print_warning", heard.append)
    return heard


def test_all_that_is_wrong_with_the_motion_is_told(tmp_path, told):
    assert Demo(motion="mine.csv", out=tmp_path, joint_order="isaaclab").run() == 0
    assert told == ["isaaclab", OF_THE_READER, "bridge", "wire"]


def test_no_wire_is_announced_where_a_check_ends_it(tmp_path, told):
    (tmp_path / "session.mcap").touch()
    with pytest.raises(RecordingError):
        Demo(motion="mine.csv", out=tmp_path).run()
    assert told == [None, OF_THE_READER]


def test_a_page_that_is_there_is_refused_before_anything_starts(tmp_path, told):
    (tmp_path / "report.html").write_text("precious")
    with pytest.raises(RecordingError, match=r"report\.html exists already"):
        Demo(motion="mine.csv", out=tmp_path).run()
    assert told == []


@pytest.mark.parametrize("installed", [True, False])
def test_the_page_is_of_the_command_report(tmp_path, told, monkeypatch, capsys, installed):
    calls = []

    class Report:
        def __init__(self, **asked):
            calls.append(asked)

        def run(self):
            print("written")  # noqa: T201

    def load(name):
        assert name == "report"
        if not installed:
            raise ConfigError("It is not installed.", "pip install it.")
        return Report

    monkeypatch.setattr("g1stream.cli.demo.load_command", load)
    _write_page(tmp_path / "s.mcap", tmp_path / "report.html")
    printed = capsys.readouterr()
    assert printed.out == ""  # where the summary is
    asked = {"sessions": (tmp_path / "s.mcap",), "out": tmp_path / "report.html", "force": True}
    assert calls == ([asked] if installed else [])
    assert installed or told == ["no report.html: It is not installed. pip install it."]
