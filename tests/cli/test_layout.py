"""`g1stream layout` writes a file and loses none."""

from __future__ import annotations

import json

from g1stream.cli.main import main


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
