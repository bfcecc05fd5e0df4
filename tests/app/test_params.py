from hashlib import sha256

import numpy as np
import pytest

import g1stream
from g1stream.app.sim import make_world
from g1stream.config import SimConfig, load_config
from g1stream.errors import ConfigError
from g1stream.robot.joints import EXAMPLE_KP, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.sim.world import MotorCommand

TEXT = """
command_delay = 0.007
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


def played(path, feedforward):
    over = {"params": path, "record.channels": "raw", "stream.feedforward": feedforward}
    return g1stream.rollout("demo", config=load_config(over=over), seconds=1.0).summary()


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


def test_the_session_and_the_feed_forward_have_them(params):
    """Of the same robot, a stream that knows its parameters is closer, and not late."""
    summary = played(params, "dynamics")
    info, knows = summary.params, summary.tracking.all_joints
    assert (info.path, info.sha256) == (str(params), sha256(TEXT.encode()).hexdigest())
    assert info.values["mass"] == {"torso_link": 1.0}
    assert info.values["command_delay"] == 0.007
    assert str(info) in " ".join(summary.details.split())
    assert knows.rmse_rad < 0.2 * played(params, "velocity").tracking.all_joints.rmse_rad
    assert knows.delay_s == pytest.approx(0.0, abs=0.001)  # commands are earlier by it
    assert summary.stream.preview_s == pytest.approx(0.008)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.toml"):
        G1.load(params=tmp_path / "none.toml")
