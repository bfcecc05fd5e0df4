import json
from hashlib import sha256

import numpy as np
import pytest

import g1stream
from g1stream.app.sim import make_world
from g1stream.cli.main import main
from g1stream.config import SimConfig, load_config
from g1stream.errors import ConfigError
from g1stream.robot.joints import EXAMPLE_KP, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.sim.world import MotorCommand

TEXT = """
command_delay = 0.006
[damping]
"*" = 0.15
[friction]
"*" = 0.5
[armature]
"*" = 0.03
[torque_scale]
"*" = 0.8
[mass]
torso_link = 1.0
"""
ELBOW = JOINT_NAMES.index("left_elbow_joint")


@pytest.fixture
def params(tmp_path):
    path = tmp_path / "g1.toml"
    path.write_text(TEXT)
    return path


@pytest.fixture(scope="module")
def rollouts(tmp_path_factory):
    """Of a robot with parameters, whose feed-forward has them."""
    path = tmp_path_factory.mktemp("params") / "g1.toml"
    path.write_text(TEXT)
    config = load_config(over={"params": path, "record.channels": "raw"})
    return path, g1stream.rollout("demo", config=config, seconds=2.0)


def test_the_simulated_motors_apply_the_scaled_torque(params):
    target = np.zeros(N_JOINTS)
    target[ELBOW] = 0.1
    off = MotorCommand.off()
    command = off._replace(enabled=np.ones(N_JOINTS, bool), q=target, kp=EXAMPLE_KP)
    worlds = [make_world(G1.load(params=path), SimConfig()) for path in (None, params)]
    for world in worlds:
        world.step(command)
    nominal, scaled = (world.state().tau_est for world in worlds)
    assert nominal[ELBOW] == pytest.approx(0.1 * EXAMPLE_KP[ELBOW])
    assert scaled == pytest.approx(0.8 * nominal)


def test_the_simulated_joints_have_the_damping(params):
    model = make_world(G1.load(params=params), SimConfig()).model
    assert (model.dof_damping[:N_JOINTS] == 0.15).all()
    assert (model.dof_frictionloss[:N_JOINTS] == 0.5).all()


def test_the_session_has_them(rollouts):
    path, session = rollouts
    info = session.summary().params
    assert (info.path, info.sha256) == (str(path), sha256(TEXT.encode()).hexdigest())
    assert info.values["mass"] == {"torso_link": 1.0}
    assert info.values["command_delay"] == 0.006
    assert str(info).startswith("g1.toml, command delay 0.006 s, damping of 1")
    assert str(info) in " ".join(str(session.summary()).split())


def test_the_feed_forward_has_them(rollouts):
    """Of the same robot, a stream that knows its parameters is closer, and not late."""
    path, session = rollouts
    knows = session.summary().tracking.all_joints
    config = load_config(
        over={"params": path, "record.channels": "raw", "stream.feedforward": "velocity"}
    )
    without = g1stream.rollout("demo", config=config, seconds=2.0).summary().tracking.all_joints
    assert knows.rmse_rad < 0.2 * without.rmse_rad
    assert knows.delay_s == pytest.approx(0.0, abs=0.001)  # commands are earlier by it
    assert session.summary().stream.preview_s == pytest.approx(0.008)


def test_parameters_of_another_robot_are_refused(params):
    params.write_text('robot = "g1_29dof"')
    config = load_config(over={"params": params, "robot": "g1_29dof_rev_1_0"})
    with pytest.raises(ConfigError):
        g1stream.rollout("demo", config=config, seconds=1.0)


def test_info_prints_them(rollouts, tmp_path, capsys):
    _, session = rollouts
    session.save(tmp_path / "session.mcap")
    assert main(["info", str(tmp_path / "session.mcap"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["params"]["values"]["friction"] == {"*": 0.5}


def test_bad_input(tmp_path, capsys):
    assert main(["sim", "--params", str(tmp_path / "none.toml"), "--domain", "99"]) == 2
    assert "none.toml" in capsys.readouterr().err
