import numpy as np
import pytest

from g1stream.errors import ConfigError
from g1stream.robot.dynamics import (
    STICTION_SPEED,
    BaseMotion,
    InverseDynamics,
    compiled_dynamics,
)
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.robot.parameters import NOMINAL, load_parameters

KNEE = JOINT_NAMES.index("left_knee_joint")
AT_REST = BaseMotion(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "g1.toml"
        path.write_text(text)
        return path

    return write


def test_values_by_pattern_and_joint(written):
    path = written('[damping]\nlegs = 0.2\nleft_knee_joint = 0.3\n[torque_scale]\n"*" = 0.9\n')
    read = load_parameters(path)
    legs = np.arange(N_JOINTS) < 12
    assert read.damping[KNEE] == 0.3
    assert (read.damping[legs & (np.arange(N_JOINTS) != KNEE)] == 0.2).all()
    assert (read.damping[~legs] == DAMPING[~legs]).all()
    assert (read.friction == FRICTION).all()
    assert (read.armature == ARMATURE).all()
    assert (read.torque_scale == 0.9).all()
    assert read.values == {
        "damping": {"legs": 0.2, "left_knee_joint": 0.3},
        "torque_scale": {"*": 0.9},
    }


def test_nothing_in_the_file_is_the_default(written):
    read = load_parameters(written(""))
    assert (read.command_delay, read.mass, read.com, read.robot) == (0.0, {}, {}, None)
    assert (read.damping == NOMINAL.damping).all()
    assert len(read.sha256) == 64


@pytest.mark.parametrize(
    "text",
    [
        "[damping]\nno_such_joint = 0.1",
        "[damping]\nleft_knee_joint = -0.1",
        "[friction]\nleft_knee_joint = 'much'",
        "[com]\ntorso_link = [0.0, 0.0]",
        "[stiffness]\nleft_knee_joint = 1.0",
        "command_delay = 1.0",
        "robot = 5",
        "[mass",
    ],
)
def test_what_is_not_valid_is_refused(written, text):
    with pytest.raises(ConfigError):
        load_parameters(written(text))


def test_links_that_are_none_are_refused_where_a_model_is_made(written):
    for text in ("[mass]\nno_link = 1.0", "[mass]\ntorso_link = -15.0"):
        with pytest.raises(ConfigError):
            InverseDynamics(G1.load(params=written(text)))


def test_the_parameters_name_their_robot(written):
    path = written('robot = "g1_29dof"')
    assert G1.load(params=path).name == "g1_29dof"
    assert G1.load("g1_29dof", params=path).name == "g1_29dof"
    with pytest.raises(ConfigError):
        G1.load("g1_29dof_rev_1_0", params=path)


def test_the_model_has_them(written):
    text = """
        [armature]
        left_knee_joint = 0.03
        [friction]
        left_knee_joint = 0.7
        [mass]
        torso_link = 1.0
        [com]
        torso_link = [0.0, 0.02, 0.0]
    """
    nominal = compiled_dynamics(G1.default(), 9.81)
    model = compiled_dynamics(G1.load(params=written(text)), 9.81)
    dof = model.joint("left_knee_joint").dofadr[0]
    assert model.dof_armature[dof] == 0.03
    assert model.dof_frictionloss[dof] == 0.7
    torso = model.body("torso_link").id
    added = np.zeros(model.nbody)
    added[torso] = 1.0
    assert model.body_mass - nominal.body_mass == pytest.approx(added, abs=1e-12)
    shift = model.body_ipos[torso] - nominal.body_ipos[torso]
    assert shift == pytest.approx([0.0, 0.02, 0.0], abs=1e-12)
    assert model.body_inertia[torso] == pytest.approx(nominal.body_inertia[torso])


def test_the_torque_of_a_movement_differs_by_them(written):
    path = written(
        "[armature]\nleft_knee_joint = 0.03\n[damping]\nleft_knee_joint = 0.25\n"
        "[friction]\nwaist_yaw_joint = 1.5\n"
    )
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-0.3, 0.3, (3, N_JOINTS))
    nominal = InverseDynamics(G1.default()).solve("bolted", q, dq, ddq, AT_REST).tau
    tau = InverseDynamics(G1.load(params=path)).solve("bolted", q, dq, ddq, AT_REST).tau
    differs = np.zeros(N_JOINTS)
    differs[KNEE] = (0.03 - ARMATURE[KNEE]) * ddq[KNEE] + (0.25 - DAMPING[KNEE]) * dq[KNEE]
    differs[12] = (1.5 - FRICTION[12]) * np.tanh(dq[12] / STICTION_SPEED)
    assert tau - nominal == pytest.approx(differs, abs=1e-9)
