"""`g1stream layout` writes a file and loses none."""

from __future__ import annotations

import json

from g1stream import Config, rollout
from g1stream.cli.main import main

ANKLE = "left_ankle_roll_joint"


def test_a_layout_that_is_there_is_replaced_with_force_only(tmp_path, capsys):
    arguments = ["layout", "foxglove", "--dir", str(tmp_path / "layouts")]
    assert main(arguments) == 0
    path = tmp_path / "layouts" / "g1stream-foxglove.json"
    assert str(path) in capsys.readouterr().out
    path.write_text("mine")
    assert main(arguments) == 2
    assert path.read_text() == "mine"
    assert "--force" in capsys.readouterr().err
    assert main([*arguments, "--force"]) == 0
    assert json.loads(path.read_text())
    assert [one.name for one in path.parent.iterdir()] == [path.name]


def test_the_torque_limits_are_those_of_the_sessions_robot(tmp_path, monkeypatch):
    """`left_ankle_roll` has 50 N·m on this robot, and 35 on the default one."""
    config = Config.model_validate({"robot": "g1_29dof"})
    session = rollout("demo", seconds=0.2, config=config, feedforward="none")
    path = session.save(tmp_path / "session.mcap")
    monkeypatch.setattr("g1stream.analysis.tracking.worst_joints", lambda *_: (ANKLE,))
    assert main(["layout", "lichtblick", str(path), "--dir", str(tmp_path)]) == 0
    layout = json.loads((tmp_path / "g1stream-lichtblick.json").read_text())
    drawn = [one["value"] for one in layout["configById"][f"Plot!{ANKLE}-torque"]["paths"]]
    assert {"50", "-50"} <= set(drawn)
