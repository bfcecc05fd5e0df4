"""The examples run as they are written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from g1stream.config import Config
from g1stream.programs.child_process import Child
from g1stream.programs.rollout import rollout
from g1stream.session.session import open_session

EXAMPLES = Path(__file__).parents[1] / "examples"


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
            command("record_other_publisher.py", other, "--seconds=12"),
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


def run(name: str, *arguments: object) -> str:
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_a_sweep_with_rollouts(tmp_path):
    picture = tmp_path / "sweep.png"
    printed = run("sweep_rollout.py", "--kp", 40, 80, "--seconds", 1, "--plot", picture)
    rows = [line.split() for line in printed.splitlines()[1:]]
    assert [row[0] for row in rows] == ["40", "80"]
    assert float(rows[1][1]) < float(rows[0][1])
    assert picture.stat().st_size > 0


def test_a_joint_is_drawn(tmp_path):
    session = rollout("demo", seconds=0.5).save(tmp_path / "session.mcap")
    for arguments in ([session], []):
        picture = tmp_path / "knee.png"
        assert "left_knee_joint" in run("plot_joint.py", "left_knee_joint", picture, *arguments)
        assert picture.stat().st_size > 0
        picture.unlink()


def test_two_runs_are_compared(tmp_path):
    kinds = ("velocity", "dynamics")
    sessions = [
        rollout("demo", feedforward=kind, seconds=0.5).save(tmp_path / f"{kind}.mcap")
        for kind in kinds
    ]
    printed = run("compare_runs.py", *sessions)
    name, first, second, *_ = next(row.split() for row in printed.splitlines() if "rad" in row)
    assert name == "rmse"
    assert float(second) < float(first)
