"""`g1stream robot`: flags, output and exit codes; the calls are tested with programs."""

from __future__ import annotations

import json

import pytest

from g1stream.app import motion_service
from g1stream.cli.main import main
from g1stream.dds.motion_switcher import OnboardStatus


@pytest.fixture
def calls(monkeypatch):
    """The calls that would be made."""
    made = []
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    status = OnboardStatus(form="0", name="ai")
    monkeypatch.setattr(
        motion_service, "onboard_status", lambda *args: made.append(("status", *args)) or status
    )
    monkeypatch.setattr(
        motion_service, "release_mode", lambda *args: made.append(("release", *args)) or "ai"
    )
    monkeypatch.setattr(
        motion_service, "restore_mode", lambda *args: made.append(("restore", *args)) or "ai"
    )
    return made


def test_status_as_json(calls, capsys):
    assert main(["robot", "status", "--json", "--domain", "9"]) == 0
    assert json.loads(capsys.readouterr().out) == {"form": "0", "name": "ai"}
    ((name, where, timeout),) = calls
    assert (name, where.domain, where.interface, timeout) == ("status", 9, "lo", 5.0)


def test_release_on_loopback_needs_no_confirmation(calls, capsys):
    assert main(["robot", "release", "--timeout", "2"]) == 0
    assert [(name, args[-1]) for name, *args in calls] == [("release", 2.0)]
    assert "g1stream robot restore ai" in capsys.readouterr().out


def test_restore_takes_a_name(calls):
    assert main(["robot", "restore", "normal"]) == 0
    assert [(name, args[1]) for name, *args in calls] == [("restore", "normal")]


@pytest.mark.parametrize(
    "arguments",
    [
        ["dance"],
        ["restore"],
        ["status", "ai"],
        ["release", "--json"],
        ["status", "--yes", "lo"],
        ["release", "--interface", "eth9"],
        ["release", "--interface", "eth9", "--yes", "eth0"],
    ],
)
def test_bad_flags_and_no_confirmation_call_nothing(arguments, calls):
    try:
        code = main(["robot", *arguments])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert calls == []


@pytest.mark.parametrize(("typed", "code"), [("eth9\n", 0), ("yes\n", 2)])
def test_confirmed_on_the_terminal(typed, code, calls, monkeypatch):
    terminal = type("Terminal", (), {"isatty": lambda _: True, "readline": lambda _: typed})
    monkeypatch.setattr("sys.stdin", terminal())
    assert main(["robot", "release", "--interface", "eth9"]) == code
    assert len(calls) == (code == 0)
