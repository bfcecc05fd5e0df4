import json

import g1stream
from g1stream.config import load_config


def test_success_of_a_robot_that_nothing_holds(tmp_path, run):
    config = load_config(over={"stream.ramp": 0.5, "stream.hold": 0.0, "stream.damp": 0.5})
    session = g1stream.rollout("demo", seconds=0.5, support="follow", config=config)
    path = session.save(tmp_path / "session.mcap")
    summary = json.loads(run("info", path, "--json").out)
    metrics = session.metrics()
    assert summary["success"] == metrics.success.model_dump(mode="json")
    assert summary["terminations"] == metrics.body.terminations.model_dump(mode="json")


def test_a_file_that_does_not_exist_is_no_session(tmp_path, run):
    ended = run("info", tmp_path / "none.mcap")
    assert ended.code == 2
    assert "none.mcap" in ended.err
    assert "permissions" not in ended.err
