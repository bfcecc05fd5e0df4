"""`g1stream physics` as text, as JSON and as a figure."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import pytest

from g1stream.extras.physics.result import MotionPhysics
from g1stream.motion.readers import load_motion


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "g1stream", "physics", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.slow
def test_it_says_with_which_support_a_motion_can_be_played(tmp_path):
    path = tmp_path / "start.csv"
    load_motion("demo").frames(0, 12).save(path)
    done = run(path)
    physics = MotionPhysics.model_validate_json(run(path, "--json").stdout)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{physics}\n"
    assert (physics.frames, physics.robot) == (12, "g1_29dof_rev_1_0")
    assert {verdict.playable for verdict in physics.verdicts.values()} == {"yes"}


@pytest.mark.slow
def test_it_uses_the_settings(tmp_path):
    motion, path = load_motion("demo").frames(30, 42), tmp_path / "squat.csv"
    motion.save(path)
    config = tmp_path / "config.toml"
    config.write_text('robot = "g1_29dof"\n[safety]\nmax_tilt = 0.05\n')
    asked = ["--json", "--config", config, "--joints"]
    physics = MotionPhysics.model_validate_json(run(path, *asked, "arms,waist").stdout)
    assert physics.robot == "g1_29dof"
    assert physics.verdicts["follow"].playable == "no"
    assert physics.tilt_rad > 0.05
    assert physics.verdicts["feet"].changed.startswith("on legs that stand")
    physics = MotionPhysics.model_validate_json(run(path, *asked, "left_leg").stdout)
    assert physics.verdicts["feet"].playable == "no"


def test_a_motion_in_degrees_is_refused(tmp_path):
    motion, path = load_motion("demo").frames(0, 12), tmp_path / "degrees.csv"
    replace(motion, joint_pos=motion.joint_pos * 180).save(path)
    done = run(path, "--json")
    assert (done.returncode, done.stdout) == (2, "")
    assert "not in radians" in done.stderr
