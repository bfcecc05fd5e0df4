"""What a session shows of the robot, on simulated ones."""

from __future__ import annotations

import json

import pytest

from g1stream.analysis.identify import identify
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.errors import RecordingError
from g1stream.programs.rollout import rollout
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.model import G1, REVISIONS


def session(robot, support, seconds=2.0, ramp=3.0):
    config = load_config(None, {"robot": robot, "stream.ramp": ramp, "stream.hold": 0.0})
    return rollout("demo", support=support, config=config, seconds=seconds)


@pytest.mark.slow
@pytest.mark.parametrize("support", ["bolted", "hanging"])
@pytest.mark.parametrize("expected", [0, 1])
def test_revision_and_torso_are_those_of_the_simulated_robot(expected, support):
    found = identify(session(REVISIONS[expected], support))
    mass, centre = InverseDynamics(G1.load(REVISIONS[expected])).carrier
    assert found.robot == REVISIONS[expected]
    assert found.position == pytest.approx(expected, abs=0.25)
    assert found.torso_centre_m == pytest.approx(centre, abs=0.004)
    assert found.time_scale == pytest.approx(1.0, abs=0.01)
    if support == "bolted":
        assert found.torso_mass_kg == pytest.approx(mass, abs=0.4)
    else:
        assert found.torso_mass_kg is None


@pytest.mark.slow
def test_the_command_prints_it(tmp_path, capsys):
    path = tmp_path / "session.mcap"
    session(REVISIONS[1], "hanging", 0.5).save(path)
    assert main(["identify", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["robot"] == REVISIONS[1]
    assert main(["identify", str(path)]) == 0
    assert REVISIONS[1] in capsys.readouterr().out


@pytest.mark.slow
def test_the_support_of_a_killed_stream_is_that_of_its_log():
    killed = session(None, "hanging", 0.5)
    del killed.metadata["stream"]
    assert identify(killed).support == "hanging"


@pytest.mark.slow
@pytest.mark.parametrize("support", ["follow", "free"])
def test_other_supports_are_refused(support):
    with pytest.raises(RecordingError, match=support):
        identify(session(None, support, seconds=0.1, ramp=0.5))


@pytest.mark.slow
def test_a_robot_that_lacks_joints_is_refused():
    with pytest.raises(RecordingError, match="lacks 6 joints"):
        identify(session("g1_23dof", "bolted", seconds=0.1, ramp=0.5))
