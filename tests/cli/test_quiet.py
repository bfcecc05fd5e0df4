import json
import logging
import os
from dataclasses import dataclass

import pytest

from g1stream.cli import main as program
from g1stream.cli.command import (
    Command,
    announce_wire,
    print_json,
    print_lines,
    print_note,
    print_warning,
)
from g1stream.cli.flags import flag
from g1stream.cli.progress import ProgressDisplay
from g1stream.config import Config
from g1stream.doctor.facts import ok, warning
from g1stream.errors import ConfigError
from g1stream.events import QUIET, ConsoleHandler, handled_by, is_quiet


@dataclass(frozen=True, kw_only=True)
class Talkative(Command):
    """A command that says all that commands say."""

    json: bool = flag(False, "JSON.")
    fails: bool = flag(False, "Fail.")

    def run(self):
        print_note("a note")
        print_warning("a fault")
        announce_wire(Config.model_validate({"dds": {"interface": "eth0"}}))
        announce_wire(Config())
        with handled_by(ConsoleHandler()):
            logging.getLogger("g1stream.test").error("an error")
            logging.getLogger("g1stream.test").warning("an event")
        with ProgressDisplay(lambda: (None, "progress"), in_pipe=0.001):
            if self.fails:
                raise ConfigError("It fails.", "Nothing.")
        if self.json:
            print_json({"is_quiet": is_quiet()})
        else:
            print_lines("a summary")
        return 0


@pytest.fixture
def talk(monkeypatch, capsys):
    monkeypatch.setattr(program, "load_command", lambda _: Talkative)
    monkeypatch.delenv(QUIET, raising=False)
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)

    def run(*flags):
        code = program.main(["info", *flags])
        return code, *capsys.readouterr()

    return run


def test_without_it_everything_is_said(talk):
    code, out, err = talk()
    assert (code, out) == (0, "a summary\n")
    for said in ("a note", "a fault", "WARNING", "domain 1 on lo", "an error", "an event"):
        assert said in err


@pytest.mark.parametrize("name", ["-q", "--quiet"])
def test_warnings_and_errors_stay(talk, name):
    code, out, err = talk(name)
    assert (code, out) == (0, "")
    for said in ("a fault", "WARNING", "an error", "an event"):
        assert said in err
    for hidden in ("a note", "domain 1 on lo.", "progress"):
        assert hidden not in err
    assert QUIET not in os.environ


def test_doctor_prints_what_is_not_in_order(monkeypatch, capsys):
    findings = [ok("one", "is in order"), warning("another", "is not", "Mend it.")]
    monkeypatch.setattr("g1stream.doctor.inspection.diagnose", lambda *_: findings)
    assert program.main(["doctor", "-q"]) == 1
    printed = capsys.readouterr()
    assert (printed.out, "another" in printed.err, "one " in printed.err) == ("", True, False)
    findings.pop()
    assert program.main(["doctor", "-q"]) == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("before", ["", "1"])
def test_the_environment_stays_as_it_was(talk, monkeypatch, before):
    monkeypatch.setenv(QUIET, before)
    talk("-q")
    talk("-q", "--fails")
    assert os.environ[QUIET] == before


def test_what_json_asks_for_and_a_failure_stay(talk):
    code, out, _ = talk("-q", "--json")
    assert (code, json.loads(out)) == (0, {"is_quiet": True})
    code, out, err = talk("-q", "--fails")
    assert (code, out) == (2, "")
    assert "error: It fails." in err
    assert not is_quiet()


@pytest.mark.parametrize(("quiet", "level"), [("", logging.INFO), ("1", logging.WARNING)])
def test_events_of_child_processes(monkeypatch, quiet, level):
    """They have the environment of the command, and nothing else of it."""
    monkeypatch.setenv(QUIET, quiet)
    assert ConsoleHandler().level == level
    assert ConsoleHandler(logging.ERROR).level == logging.ERROR
