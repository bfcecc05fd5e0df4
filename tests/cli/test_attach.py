"""`g1stream attach`, and --motion of the commands that show sessions."""

from __future__ import annotations

import json

import numpy as np
import pytest

import g1stream
from g1stream.cli.main import main
from g1stream.dds.messages import LOWCMD, LOWSTATE, encode_samples
from g1stream.session.writer import SessionWriter

T0 = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def theirs(tmp_path_factory):
    """Commands and states of the bundled motion, begun 3 s after the first message."""
    path = tmp_path_factory.mktemp("theirs") / "theirs.mcap"
    time = np.arange(0.0, 14.0, 0.01)
    q = g1stream.Trajectory(g1stream.load_motion("demo")).sample_joints(time - 3.0)[0]
    stamps = T0 + np.round(time * 1e9).astype(np.int64)
    command = {"motor_cmd.q": q, "motor_cmd.kp": np.full(q.shape, 50.0)}
    state = {
        "motor_state.q": q - 0.01,
        "imu_state.quaternion": np.tile([1.0, 0, 0, 0], (len(q), 1)),
    }
    with SessionWriter(path) as writer:
        for topic, fields in ((LOWCMD, command), (LOWSTATE, state)):
            data = encode_samples(topic, fields, len(q))
            writer.write_batch(topic.name.replace("rt/", "/"), data, stamps + 9, stamps)
    return path


def test_what_was_found_is_printed_and_written(theirs, tmp_path, capsys):
    out = tmp_path / "attached.mcap"
    assert main(["attach", str(theirs), "demo", "-o", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    session = g1stream.open_session(out)
    assert found == session.attached.model_dump(mode="json")
    assert (found["by"], found["start_s"]) == ("commands", pytest.approx(3.0, abs=1e-3))
    assert session.tracking().mean == pytest.approx(np.full(29, 0.01), abs=1e-3)


def test_without_out_nothing_is_written(theirs, capsys):
    before = sorted(theirs.parent.iterdir())
    assert main(["attach", str(theirs), "demo"]) == 0
    assert "of the motion, starting 3.0" in capsys.readouterr().out
    assert sorted(theirs.parent.iterdir()) == before


def test_the_commands_that_show_sessions_take_the_motion(theirs, tmp_path, capsys):
    motion = ["--motion", "demo"]
    assert main(["info", str(theirs), *motion, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["tracking"]["all_joints"]["rmse_rad"] == pytest.approx(0.01, abs=1e-3)
    assert (
        main(["plot", str(theirs), *motion, "-o", str(tmp_path / "plot.svg"), "--what", "error"])
        == 0
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ["attach", "{theirs}", "demo", "--play", "2"],
        ["attach", "{theirs}", "demo", "-o", "{theirs}"],
        ["attach", "{theirs}", "demo", "-o", "out.csv"],
        ["attach", "{theirs}", "demo", "--force"],
        ["attach", "nothing.mcap", "demo"],
        ["info", "{theirs}", "--motion", "nothing.csv"],
    ],
)
def test_refusals(theirs, arguments, capsys):
    content = theirs.read_bytes()
    assert main([one.format(theirs=theirs) for one in arguments]) == 2
    assert capsys.readouterr().err.startswith("error: ")
    assert theirs.read_bytes() == content
