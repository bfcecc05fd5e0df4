import json
from dataclasses import replace

import numpy as np
import pytest

from g1stream.app.rollout import rollout
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.fit.excite import exciting_motion
from g1stream.extras.fit.identify import fit_parameters
from g1stream.extras.fit.recorded import Recorded
from g1stream.extras.fit.simulated_session import servo_law
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.parameters import load_parameters

ELBOW = "left_elbow_joint"
SHORT = {"stream.ramp": 0.5, "stream.hold": 0.0, "stream.damp": 0.5}


@pytest.fixture(scope="module")
def hidden(foreign):
    rng = np.random.default_rng(3)
    return foreign(
        damping=DAMPING * rng.uniform(0.5, 3.0, N_JOINTS),
        friction=FRICTION * rng.uniform(0.5, 3.0, N_JOINTS),
        armature=ARMATURE * rng.uniform(0.5, 2.0, N_JOINTS),
        delay=0.0055,
        mass={"torso_link": 1.0},
    )


@pytest.fixture(scope="module")
def motion():
    """Which holds the left elbow still."""
    moving = exciting_motion(seconds=12.0, seed=1)
    still = moving.joint_pos.copy()
    still[:, JOINT_NAMES.index(ELBOW)] = 0.6
    return replace(moving, joint_pos=still)


@pytest.fixture(scope="module")
def session(hidden, motion):
    return hidden.play(motion, seed=1)


@pytest.fixture(scope="module")
def fit(session):
    return fit_parameters([session], support="bolted")


def truth(hidden, one):
    if one.kind == "mass":
        return hidden.mass.get(one.name, 0.0)
    if one.kind == "command_delay":
        return hidden.delay
    values = hidden.scale if one.kind == "torque_scale" else getattr(hidden, one.kind)
    return values[JOINT_NAMES.index(one.name)]


def inside(hidden, one):
    return one.low <= truth(hidden, one) <= one.high


def test_the_true_values_are_inside_the_intervals(fit, hidden):
    told = [one for one in fit.values if one.told]
    assert len(fit.values) == 4 * N_JOINTS + 13 + 1
    assert len(told) > 0.75 * len(fit.values)
    for kind in ("damping", "friction", "armature", "torque_scale", "mass"):
        assert np.mean([inside(hidden, one) for one in told if one.kind == kind]) > 0.9, kind
    torso = fit.find("mass", "torso_link")
    assert torso.told
    assert torso.value == pytest.approx(1.0, abs=0.25)
    wrist = fit.find("friction", "left_wrist_roll_joint")
    assert wrist.value == pytest.approx(truth(hidden, wrist), rel=0.05)


def test_a_delay_between_ticks(fit, hidden):
    delay = fit.find("command_delay")
    assert delay.told
    assert inside(hidden, delay)
    assert delay.high - delay.low < 0.003


def test_the_torque_of_an_instant_and_of_a_period_give_the_same(fit, hidden, motion):
    other = replace(hidden, reports="mean").play(motion, seed=1)
    found = fit_parameters([other], support="bolted")
    for one in (one for one in fit.values if one.told):
        mean = found.find(one.kind, one.name)
        assert mean.value == pytest.approx(one.value, abs=0.1 * (one.high - one.low)), one


def test_a_scale_that_differs_is_found_and_the_others_are_not_written(fit, hidden, motion):
    assert not [one.name for one in fit.values if one.kind == "torque_scale" and one.written]
    scale = np.ones(N_JOINTS)
    scale[0] = 0.9
    other = replace(hidden, scale=scale).play(motion, seed=2)
    found = servo_law([Recorded.of(other)], G1.default())
    assert found.scale[:2] == pytest.approx([0.9, 1.0], abs=0.005)


def test_what_the_session_does_not_show_is_not_determined(fit):
    # The left elbow rests.
    assert fit.find("friction", ELBOW).why == "wide"
    assert not fit.find("armature", ELBOW).written
    assert fit.find("friction", "right_elbow_joint").told


def test_what_differs_is_marked(fit, hidden):
    marked = [one for one in fit.values if one.differs]
    default = [one for one in fit.values if truth(hidden, one) == one.default]
    assert fit.find("mass", "torso_link").differs
    assert not [one.name for one in default if one.differs]
    assert f"differs from the default: {len(marked)} of" in str(fit)
    assert str(fit).count("*") >= len(marked)


def test_a_joint_with_play_has_no_interval(hidden, motion):
    loose = replace(hidden, backlash=0.002, step=2.5e-4).play(motion, seed=1)
    fit = fit_parameters([loose], support="bolted")
    unlike = [one for one in fit.values if one.why == "unlike"]
    assert len(unlike) > N_JOINTS
    assert all(one.low is None and not one.written for one in unlike)
    delay = fit.find("command_delay")
    assert inside(hidden, delay)


@pytest.mark.parametrize(("support", "said"), [("bolted", "hanging"), ("hanging", "bolted")])
def test_a_wrong_support_is_refused(foreign, tmp_path, support, said):
    session = foreign(delay=0.005).play(exciting_motion(seconds=6.0, seed=3), support)
    fit = fit_parameters([session], support=said)
    assert fit.refusal
    with pytest.raises(RecordingError):
        fit.save(tmp_path / "g1.toml")
    recorded, params = tmp_path / "excite.mcap", tmp_path / "g1.toml"
    session.save(recorded)
    assert main(["fit", str(recorded), "-o", str(params), "--support", said]) == 1
    assert not params.exists()


def test_parameters_of_another_robot_are_refused(foreign, session, tmp_path):
    default = foreign(delay=1e-3).play(exciting_motion(seconds=6.0, seed=3))
    fit = fit_parameters([session], hold_out=default, support="bolted")
    assert fit.reduction < 0.0
    assert fit.refusal
    with pytest.raises(RecordingError):
        fit.save(tmp_path / "g1.toml")
    assert not (tmp_path / "g1.toml").exists()


def test_the_held_out_gap_shrinks(fit):
    assert fit.held_out == "the last 20 %"
    assert fit.gap_before_rad > 3e-3
    assert fit.reduction > 0.6
    assert not fit.refusal


def test_the_file_and_the_text_have_what_was_told(fit, tmp_path):
    assert all(name.removesuffix("_joint") in str(fit) for name in JOINT_NAMES)
    path = fit.save(tmp_path / "g1.toml")
    read = load_parameters(path)
    assert read.robot == "g1_29dof_rev_1_0"
    assert read.command_delay == pytest.approx(fit.find("command_delay").value, abs=1e-4)
    assert set(read.mass) <= {one.name for one in fit.values if one.kind == "mass" and one.told}
    elbow = JOINT_NAMES.index(ELBOW)
    assert read.friction[elbow] == FRICTION[elbow]
    for one in (one for one in fit.values if one.kind == "friction" and one.written):
        assert read.friction[JOINT_NAMES.index(one.name)] == pytest.approx(one.value, abs=1e-5)
    with pytest.raises(RecordingError):
        fit.save(path)


def test_from_the_command_line(session, tmp_path, capsys):
    recorded, params = tmp_path / "excite.mcap", tmp_path / "g1.toml"
    session.save(recorded)
    assert main(["fit", str(recorded), "-o", str(params), "--support", "bolted", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["robot"] == load_parameters(params).robot
    assert {one["differs"] for one in printed["values"]} == {True, False}
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
