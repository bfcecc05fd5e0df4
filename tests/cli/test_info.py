"""What `g1stream info` adds to the summary of a session."""

import json

import pytest

import g1stream
from g1stream.cli.main import main
from g1stream.config import load_config


@pytest.mark.parametrize(("support", "told"), [("follow", True), ("bolted", False)])
def test_success_of_a_robot_that_nothing_holds(tmp_path, capsys, support, told):
    config = load_config(over={"stream.ramp": 0.5, "stream.hold": 0.0, "stream.damp": 0.5})
    session = g1stream.rollout("demo", seconds=0.5, support=support, config=config)
    path = session.save(tmp_path / "session.mcap")
    assert main(["info", str(path), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["success"] is not None) is told
    if told:
        metrics = session.metrics()
        assert summary["success"] == metrics.success.model_dump(mode="json")
        assert summary["terminations"] == metrics.body.terminations.model_dump(mode="json")


def test_a_file_that_does_not_exist_is_no_session(tmp_path, capsys):
    assert main(["info", str(tmp_path / "none.mcap")]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "none.mcap" in told
    assert "permissions" not in told
