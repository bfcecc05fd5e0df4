"""`g1stream rerun` and `g1stream layout rerun` on the command line."""

from __future__ import annotations

import pytest

from g1stream.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((), "--live"),
        (("--live", "session.mcap"), "--live"),
        (("--live", "--out", "session.rrd"), "--out"),
        (("session.mcap", "--domain", "0"), "--domain"),
        (("session.mcap", "--config", "robot"), "--config"),
        (("session.mcap", "--out", "a.rrd", "--connect", "127.0.0.1:9876"), "--connect"),
        (("missing.mcap",), "missing.mcap"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["rerun", *arguments]) == 2
    assert named in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_layout_is_for_recordings_of_g1stream(tmp_path, capsys):
    pytest.importorskip("rerun", reason="Rerun needs Python 3.11")
    from rerun.chunk import RrdReader

    assert main(["layout", "rerun", "--dir", str(tmp_path)]) == 0
    (entry,) = RrdReader(tmp_path / "g1stream-rerun.rbl").blueprints()
    assert entry.application_id == "g1stream"
