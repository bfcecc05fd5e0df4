import runpy
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

import g1stream
from g1stream.app.rollout import rollout
from g1stream.app.session import open_session
from g1stream.child_process import Child
from g1stream.config import Config
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.robot.shapes import read_visuals
from g1stream.session.writer import SessionWriter
from g1stream.testing import SyntheticSession

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.dds
@pytest.mark.slow
def test_one_streams_a_motion_while_the_other_records_it(domain_id, tmp_path):
    def command(name: str, *arguments: object) -> list[str]:
        return [sys.executable, str(EXAMPLES / name), *map(str, arguments), f"--domain={domain_id}"]

    own, other = tmp_path / "own.mcap", tmp_path / "other.mcap"
    simulator = Child("sim", Config.model_validate({"dds": {"domain": domain_id}}))
    try:
        simulator.wait_until_ready()
        with subprocess.Popen(
            command("record_other_publisher.py", other, "--seconds=25"),
            stdout=subprocess.PIPE,
            text=True,
        ) as recorder:
            streamed = subprocess.run(
                command("stream_csv.py", "demo", own, "--duration=1"),
                capture_output=True,
                text=True,
                check=True,
            )
            recorded, _ = recorder.communicate(timeout=60)
    finally:
        simulator.kill()
    assert "RMSE" in streamed.stdout
    assert recorder.returncode == 0
    assert "/lowstate" in recorded
    assert "moved most" in recorded
    commands = [open_session(path).topics["/lowcmd"] for path in (own, other)]
    assert 0 < commands[1] <= commands[0] + 5


@pytest.fixture
def run(monkeypatch, capsys, short):
    """Run an example, whose rollouts are short, and return what it prints."""
    less = {"config": short, "seconds": 0.5}
    monkeypatch.setattr(g1stream, "rollout", lambda *args, **how: rollout(*args, **how | less))

    def run_example(name, *arguments):
        path = str(EXAMPLES / name)
        monkeypatch.setattr(sys, "argv", [path, *map(str, arguments)])
        runpy.run_path(path, run_name="__main__")
        return capsys.readouterr().out

    return run_example


def write(path: Path, delay: float = 0.0) -> Path:
    """A session of a robot that is so late, s."""
    with SessionWriter(path) as writer:
        SyntheticSession(1.0, delay=delay).write(writer)
    return path


@pytest.mark.slow
def test_a_sweep_with_rollouts(run, tmp_path):
    picture = tmp_path / "sweep.png"
    printed = run("sweep_rollout.py", "--kp", 40, 80, "--plot", picture)
    rows = [line.split() for line in printed.splitlines()[1:]]
    assert [row[0] for row in rows] == ["40", "80"]
    assert float(rows[1][1]) < float(rows[0][1])
    assert picture.stat().st_size > 0


@pytest.mark.slow
def test_a_joint_is_drawn(run, tmp_path):
    session = write(tmp_path / "session.mcap")
    for arguments in ([session], []):
        picture = tmp_path / "knee.png"
        assert "left_knee_joint" in run("plot_joint.py", "left_knee_joint", picture, *arguments)
        assert picture.stat().st_size > 0
        picture.unlink()


@pytest.mark.slow
def test_two_runs_are_compared(run, tmp_path):
    sessions = [write(tmp_path / f"{delay}.mcap", delay) for delay in (0.04, 0.01)]
    printed = run("compare_runs.py", *sessions)
    (row,) = (line.split() for line in printed.splitlines() if line.startswith("rmse "))
    assert float(row[2]) < float(row[1])


@pytest.mark.slow
def test_steps_are_made_and_played(run, tmp_path):
    pytest.importorskip("daqp")
    printed = run("steps.py", tmp_path / "steps.npz", "--pairs", 1)
    assert printed.startswith("can be played")
    assert "RMSE" in printed
    assert load_motion(tmp_path / "steps.npz").duration == pytest.approx(6.4)


@pytest.mark.slow
def test_a_session_is_shown_in_rerun(short, tmp_path):
    pytest.importorskip("rerun", reason="Rerun needs Python 3.11")
    from rerun.chunk import RrdReader

    path, out = tmp_path / "session.mcap", tmp_path / "session.rrd"
    rollout("demo", seconds=0.3, config=short).save(path)
    subprocess.run([sys.executable, EXAMPLES / "rerun_session.py", path, "-o", out], check=True)
    reader = RrdReader(out)
    found = defaultdict(lambda: defaultdict(list))  # by entity, the values of each column
    for store in (*reader.recordings(), *reader.blueprints()):
        for chunk in reader.stream(store=store):
            for name, values in chunk.to_record_batch().to_pydict().items():
                found[chunk.entity_path][name] += values

    measured, worst = open_session(path).measured, open_session(path).tracking().rmse.argmax()
    columns = found[f"/joints/{JOINT_NAMES[worst]}/measured"]
    np.testing.assert_array_equal(np.ravel(columns["Scalars:scalars"]), measured.q[:, worst])
    shapes_of = {"measured": "/g1_29dof_rev_1_0/", "ghost": "/ghost/g1_29dof_rev_1_0/"}
    for robot, shapes in shapes_of.items():
        drawn = {
            frame
            for place, values in found.items()
            if place.startswith(shapes)
            for (frame,) in values.get("CoordinateFrame:frame", [])
        }
        assert len(drawn) == len({visual.link for visual in read_visuals(G1.default())})
        assert f"/{robot}/tf" in found
