import json

from g1stream import Config, rollout

ANKLE = "left_ankle_roll_joint"


def test_a_layout_that_is_there_is_replaced_with_force_only(tmp_path, run):
    arguments = "layout", "foxglove", "-o", tmp_path / "layouts"
    path = tmp_path / "layouts" / "g1stream-foxglove.json"
    assert str(path) in run(*arguments).out
    path.write_text("mine")
    assert run(*arguments).code == 2
    assert path.read_text() == "mine"
    assert run(*arguments, "--force").code == 0
    assert json.loads(path.read_text())
    assert [one.name for one in path.parent.iterdir()] == [path.name]


def test_the_output_is_a_directory_or_a_file(tmp_path, run):
    inside, file = tmp_path / "run.1" / "g1stream-foxglove.json", tmp_path / "new" / "mine.json"
    inside.parent.mkdir()
    for out, path in ((inside.parent, inside), (file, file)):
        told = json.loads(run("layout", "foxglove", "-o", out, "--json").out)
        assert told["path"] == str(path)
        assert all(joint in path.read_text() for joint in told["joints"])
    assert run("layout", "plotjuggler", "-o", tmp_path / "mine.json").code == 2


def test_the_torque_limits_are_those_of_the_sessions_robot(tmp_path, monkeypatch, run):
    """`left_ankle_roll` has 50 N·m on this robot, and 35 on the default one."""
    config = Config.model_validate({"robot": "g1_29dof"})
    session = rollout("demo", seconds=0.2, config=config, feedforward="none")
    path = session.save(tmp_path / "session.mcap")
    monkeypatch.setattr("g1stream.extras.layout.layout_cli.worst_joints", lambda *_: (ANKLE,))
    assert run("layout", "lichtblick", path, "-o", tmp_path).code == 0
    layout = json.loads((tmp_path / "g1stream-lichtblick.json").read_text())
    drawn = [one["value"] for one in layout["configById"][f"Plot!{ANKLE}-torque"]["paths"]]
    assert {"50", "-50"} <= set(drawn)
