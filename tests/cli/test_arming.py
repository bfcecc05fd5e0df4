from dataclasses import replace

import pytest

from g1stream.app.arming import ArmingReport, LimbDistance
from g1stream.cli.stream import may_arm, render_arming
from g1stream.config import WiderValue
from g1stream.doctor.facts import ok, problem, warning
from g1stream.errors import ConfigError


@pytest.fixture
def report():
    return ArmingReport(
        domain=0,
        interface="eth9",
        tilt=0.05,
        limbs=(
            LimbDistance("left_leg", "left_knee_joint", 0.5, (40.0, 100.0), (1.0, 2.0)),
            LimbDistance("waist", "waist_yaw_joint", -0.75, (40.0, 60.0), (1.0, 1.0)),
        ),
        ramp=6.0,
        peak_speed=0.234,
        limits={"state_timeout": 0.1, "max_tilt": 0.5, "mode_machine": (5,)},
        wider=(WiderValue("safety.max_joint_speed", 60.0, 10.0, "rad/s"),),
        motion_service=ok("motion service", "no mode is active"),
        findings=(ok("tick", "steps of 2 ms"), problem("LowCmd", "no subscriber", "Start one.")),
    )


def test_the_text_is_the_snapshot(report, matches_snapshot):
    matches_snapshot("arming", render_arming(report))


def test_yes_names_the_interface(report, capsys):
    assert may_arm(report, yes="eth9")
    assert "waist_yaw_joint" in capsys.readouterr().err
    with pytest.raises(ConfigError):
        may_arm(report, yes="eth0")


def test_what_a_terminal_obeys_is_escaped(report, capsys):
    hostile = warning("motion service", "mode \x1b[2J", "Look.")
    may_arm(replace(report, motion_service=hostile), yes="eth9")
    printed = capsys.readouterr().err
    assert "\x1b" not in printed
    assert "\\x1b[2J" in printed


def test_without_a_terminal_yes_is_needed(report, monkeypatch):
    monkeypatch.setattr("sys.stdin", type("Pipe", (), {"isatty": lambda _: False})())
    with pytest.raises(ConfigError) as caught:
        may_arm(report, yes=None)
    assert "--yes eth9" in caught.value.remedy
