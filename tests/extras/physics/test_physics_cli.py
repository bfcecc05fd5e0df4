from dataclasses import replace

import pytest

from g1stream.app.convert import convert
from g1stream.cli.main import main
from g1stream.extras.physics.result import MotionPhysics
from g1stream.motion.motion import Motion
from g1stream.motion.readers import load_motion
from g1stream.robot.model import G1


@pytest.fixture
def run(capsys):
    """Run the command; returns its exit code and what it prints."""
    return lambda *given: (main(["physics", *map(str, given)]), *capsys.readouterr())


def test_it_says_with_which_support_a_motion_can_be_played(run, tmp_path):
    path = tmp_path / "start.npz"
    load_motion("demo").frames(0, 12).save(path)
    physics = MotionPhysics.model_validate_json(run(path, "--json")[1])
    assert run(path) == (0, f"{physics}\n", "")
    assert (physics.frames, physics.robot) == (12, "g1_29dof_rev_1_0")
    assert {verdict.playable for verdict in physics.verdicts.values()} == {"yes"}


@pytest.mark.parametrize("moved", [True, False])
def test_joints_that_the_robot_lacks_are_named_if_the_motion_moves_them(run, tmp_path, moved):
    """Of 29 joints a G1 of 23 plays 23, which is not the motion in the file."""
    demo, path = load_motion("demo").frames(30, 42), tmp_path / "part.npz"
    robot = G1.load("g1_23dof")
    only = Motion.from_arrays(demo.joint_pos * robot.present, demo.root_pos, fps=30)
    (demo if moved else only).save(path)
    code, _, told = run(path, "--robot", "g1_23dof")
    assert code == 0
    assert ("waist_roll" in told) == moved
    report = convert(path, tmp_path / "part.mcap", robot=robot)
    assert ["waist_roll" in text for text in report.warnings] == [True] * moved


def test_it_uses_the_settings(run, tmp_path):
    motion, path = load_motion("demo").frames(30, 42), tmp_path / "squat.csv"
    motion.save(path)
    config = tmp_path / "config.toml"
    config.write_text('robot = "g1_29dof"\n[safety]\nmax_tilt = 0.05\n')
    asked = ["--json", "--config", config, "--joints"]
    physics = MotionPhysics.model_validate_json(run(path, *asked, "arms,waist")[1])
    assert physics.robot == "g1_29dof"
    assert physics.verdicts["follow"].playable == "no"
    assert physics.tilt_rad > 0.05
    assert physics.verdicts["feet"].changed.startswith("on legs that stand")
    physics = MotionPhysics.model_validate_json(run(path, *asked, "left_leg")[1])
    assert physics.verdicts["feet"].playable == "no"


def test_a_motion_in_degrees_is_refused(run, tmp_path):
    motion, path = load_motion("demo").frames(0, 12), tmp_path / "degrees.csv"
    replace(motion, joint_pos=motion.joint_pos * 180).save(path)
    code, out, err = run(path, "--json")
    assert (code, out) == (2, "")
    assert "not in radians" in err
