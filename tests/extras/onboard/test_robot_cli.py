import json

import pytest

from g1stream.extras.onboard import motion_service
from g1stream.extras.onboard.motion_service import OnboardStatus


@pytest.fixture
def calls(monkeypatch):
    """The calls that would be made."""
    made = []
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    status = OnboardStatus(form="0", name="ai")
    calls = {"onboard_status": status, "release_mode": "ai", "restore_mode": "ai"}
    for name, answer in calls.items():
        monkeypatch.setattr(
            motion_service, name, lambda *args, n=name, a=answer: made.append((n, *args)) or a
        )
    return made


def test_status_as_json(calls, run):
    told = run("robot", "status", "--json", "--domain", "9")
    assert json.loads(told.out) == {"form": "0", "name": "ai"}
    ((name, where, timeout),) = calls
    assert (name, where.domain, where.interface, timeout) == ("onboard_status", 9, "lo", 5.0)


def test_what_was_released_or_restored_as_json(calls, run):
    told = run("robot", "release", "--timeout", "2", "--json")
    assert json.loads(told.out) == {"released": "ai"}
    told = run("robot", "restore", "normal", "--json")
    assert json.loads(told.out) == {"active": "normal"}


def test_release_on_loopback_needs_no_confirmation(calls, run):
    assert "g1stream robot restore ai" in run("robot", "release", "--timeout", "2").out
    assert [(name, args[-1]) for name, *args in calls] == [("release_mode", 2.0)]


def test_restore_takes_a_name(calls, run):
    assert run("robot", "restore", "normal").code == 0
    assert [(name, args[1]) for name, *args in calls] == [("restore_mode", "normal")]


@pytest.mark.parametrize(
    "arguments",
    [
        ["dance"],
        ["restore"],
        ["status", "ai"],
        ["status", "--yes", "lo"],
        ["release", "--interface", "eth9"],
        ["release", "--interface", "eth9", "--yes", "eth0"],
    ],
)
def test_bad_flags_and_no_confirmation_call_nothing(arguments, calls, run):
    assert run("robot", *arguments).code == 2
    assert calls == []


@pytest.mark.parametrize(("typed", "code"), [("eth9\n", 0), ("yes\n", 2)])
def test_confirmed_on_the_terminal(typed, code, calls, monkeypatch, run):
    terminal = type("Terminal", (), {"isatty": lambda _: True, "readline": lambda _: typed})
    monkeypatch.setattr("sys.stdin", terminal())
    assert run("robot", "release", "--interface", "eth9").code == code
    assert len(calls) == (code == 0)
