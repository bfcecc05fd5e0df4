import json

import numpy as np
import pytest

import g1stream
from g1stream.dds.messages import LOWCMD, LOWSTATE, encode_samples
from g1stream.motion.trajectory import Trajectory
from g1stream.session.writer import SessionWriter

T0 = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def theirs(tmp_path_factory):
    """Commands and states of the bundled motion, begun 3 s after the first message."""
    path = tmp_path_factory.mktemp("theirs") / "theirs.mcap"
    time = np.arange(0.0, 14.0, 0.01)
    q = Trajectory(g1stream.load_motion("demo")).sample_joints(time - 3.0)[0]
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


def test_what_was_found_is_printed_and_written(theirs, tmp_path, run):
    out = tmp_path / "attached.mcap"
    found = json.loads(run("attach", theirs, "demo", "-o", out, "--json").out)
    session = g1stream.open_session(out)
    assert found == session.attached.model_dump(mode="json")
    assert (found["by"], found["start_s"]) == ("commands", pytest.approx(3.0, abs=1e-3))
    assert session.tracking().mean == pytest.approx(np.full(29, 0.01), abs=1e-3)


def test_without_out_nothing_is_written(theirs, run):
    before = sorted(theirs.parent.iterdir())
    assert run("attach", theirs, "demo").code == 0
    assert sorted(theirs.parent.iterdir()) == before


def test_the_commands_that_show_sessions_take_the_motion(theirs, tmp_path, run):
    motion = "--motion", "demo"
    summary = json.loads(run("info", theirs, *motion, "--json").out)
    assert summary["tracking"]["all_joints"]["rmse_rad"] == pytest.approx(0.01, abs=1e-3)
    path = tmp_path / "plot.svg"
    plotted = run("plot", theirs, *motion, "-o", path, "--what", "error", "--json")
    assert json.loads(plotted.out) == {"path": str(path)}
    assert path.exists()


@pytest.mark.parametrize(("command", "flags"), [("attach", []), ("info", ["--motion"])])
def test_what_the_motion_file_does_not_say_is_told(theirs, command, flags, tmp_path, run):
    path = tmp_path / "rows.csv"
    motion = g1stream.load_motion("demo").resample(30.0)
    np.savetxt(path, motion.joint_pos, delimiter=",")
    ended = run(command, theirs, *flags, path)
    assert ended.code == 0
    assert "rows.csv: frame rate: 30 fps, assumed." in ended.err


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
def test_refusals(theirs, arguments, run):
    content = theirs.read_bytes()
    ended = run(*(one.format(theirs=theirs) for one in arguments))
    assert ended.code == 2
    assert ended.err.startswith("error: ")
    assert theirs.read_bytes() == content
