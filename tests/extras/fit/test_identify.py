import json
from dataclasses import replace

import numpy as np
import pytest

from g1stream.app.rollout import rollout
from g1stream.app.sim import make_world
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.fit.excite import exciting_motion
from g1stream.extras.fit.identify import fit_parameters
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.parameters import Parameters, load_parameters

ELBOW = "left_elbow_joint"
SHORT = {"stream.ramp": 0.5, "stream.hold": 0.0, "stream.damp": 0.5}


@pytest.fixture(scope="module")
def hidden():
    rng = np.random.default_rng(3)
    return Parameters(
        damping=DAMPING * rng.uniform(0.5, 3.0, N_JOINTS),
        friction=FRICTION * rng.uniform(0.5, 3.0, N_JOINTS),
        armature=ARMATURE * rng.uniform(0.5, 2.0, N_JOINTS),
        command_delay=0.0061,
        mass={"torso_link": 1.0},
    )


@pytest.fixture(scope="module")
def session(hidden):
    """Of the hidden robot, which holds its left elbow still; without its ramp."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "g1stream.app.rollout.make_world",
            lambda robot, settings: make_world(replace(robot, parameters=hidden), settings),
        )
        motion = exciting_motion(seconds=10.0, seed=1)
        still = motion.joint_pos.copy()
        still[:, JOINT_NAMES.index(ELBOW)] = 0.6
        over = {"record.channels": "raw", "sim.noise": 1.0, "stream.feedforward": "dynamics"}
        config = load_config(over=over | SHORT)
        return rollout(replace(motion, joint_pos=still), config=config).sel("PLAY")


@pytest.fixture(scope="module")
def fit(session):
    return fit_parameters([session])


def truth(hidden, one):
    if one.kind == "mass":
        return hidden.mass.get(one.name, 0.0)
    if one.kind == "command_delay":
        return hidden.command_delay
    return getattr(hidden, one.kind)[JOINT_NAMES.index(one.name)]


def test_the_true_values_are_inside_the_intervals(fit, hidden):
    known = [one for one in fit.values if one.kind != "torque_lag"]
    inside = [one.low <= truth(hidden, one) <= one.high for one in known]
    assert len(known) == 4 * N_JOINTS + 13 + 1
    assert np.mean(inside) > 0.88
    assert fit.find("command_delay").value == pytest.approx(0.006)
    torso = fit.find("mass", "torso_link")
    assert torso.told
    assert torso.value == pytest.approx(1.0, abs=0.25)
    wrist = fit.find("friction", "left_wrist_roll_joint")
    assert wrist.value == pytest.approx(truth(hidden, wrist), rel=0.05)
    # The left elbow rests.
    assert not fit.find("friction", ELBOW).told
    assert not fit.find("armature", ELBOW).written
    assert fit.find("friction", "right_elbow_joint").told


def test_the_held_out_gap_shrinks(fit):
    assert fit.held_out == "the last 20 %"
    assert fit.gap_before_rad > 3e-3
    assert fit.reduction > 0.6


def test_the_file_and_the_text_have_what_was_told(fit, hidden, tmp_path):
    assert all(name.removesuffix("_joint") in str(fit) for name in JOINT_NAMES)
    path = fit.save(tmp_path / "g1.toml")
    read = load_parameters(path)
    assert read.robot == "g1_29dof_rev_1_0"
    assert read.command_delay == pytest.approx(0.006)
    assert set(read.mass) <= {one.name for one in fit.values if one.kind == "mass" and one.told}
    elbow = JOINT_NAMES.index(ELBOW)
    assert read.friction[elbow] == FRICTION[elbow]
    for one in (one for one in fit.values if one.kind == "friction" and one.written):
        assert read.friction[JOINT_NAMES.index(one.name)] == pytest.approx(one.value, abs=1e-5)
    with pytest.raises(RecordingError):
        fit.save(path)


def test_from_the_command_line(session, tmp_path, capsys):
    recorded, params = tmp_path / "excite.mcap", tmp_path / "g1.toml"
    session.sel(time=slice(0.0, 3.0)).save(recorded)
    assert main(["fit", str(recorded), "-o", str(params), "--support", "bolted", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["robot"] == load_parameters(params).robot
    assert main(["fit", str(recorded), "-o", str(params)]) == 2  # it is there
    assert main(["fit"]) == 2
    assert main(["fit", str(recorded), "--motion-out", "x.npz"]) == 2


def test_what_cannot_be_fitted_is_refused():
    config = load_config(over={"record.channels": "raw"} | SHORT)
    standing = rollout("demo", config=config, seconds=0.5, support="free")
    with pytest.raises(RecordingError):
        fit_parameters([standing])


def test_the_exciting_motion(tmp_path):
    path = tmp_path / "excite.npz"
    assert main(["fit", "--motion-out", str(path), "--seconds", "8", "--robot", "g1_29dof"]) == 0
    motion, robot = load_motion(path), G1.load("g1_29dof")
    assert motion.duration == pytest.approx(8.0)
    assert (motion.joint_pos > robot.lower).all()
    assert (motion.joint_pos < robot.upper).all()
    speeds = np.gradient(motion.joint_pos, 1.0 / motion.fps, axis=0)
    assert (np.abs(speeds) < robot.velocity).all()
    assert (speeds.std(axis=0) > 0.1).all()
    assert np.abs(speeds[[0, -1]]).max() < 0.02
    other = exciting_motion(robot, seconds=6.0, seed=2)
    assert (other.joint_pos[100] != motion.joint_pos[100]).any()
    with pytest.raises(ConfigError):
        exciting_motion(robot, seconds=1.0)
