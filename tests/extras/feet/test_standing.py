import mujoco
import numpy as np
import pytest

from g1stream.extras.feet.standing import LEGS, BodyState, StandingDynamics
from g1stream.robot.dynamics import friction_torque, mujoco_spec
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_normalize

ROBOT = G1.default()


@pytest.fixture(scope="module")
def dynamics():
    return StandingDynamics(ROBOT)


@pytest.fixture
def state():
    rng = np.random.default_rng(4)
    q = rng.uniform(-0.2, 0.2, 29)
    for side in ("left", "right"):
        q[JOINT_NAMES.index(f"{side}_knee_joint")] = 0.7
    quat = quat_normalize(np.array([1.0, 0.05, -0.08, 0.3]))
    return BodyState(quat, rng.uniform(-0.3, 0.3, 3), q, rng.uniform(-0.5, 0.5, 29))


@pytest.mark.parametrize("stands", [(True, True), (True, False), (False, True)])
def test_its_torques_and_wrenches_give_its_accelerations(dynamics, state, stands):
    """Put into MuJoCo, they move waist, arms and a lifted leg as given, and no sole that stands."""
    rng = np.random.default_rng(5)
    given, wrench = rng.uniform(-2.0, 2.0, 29), rng.uniform(-30.0, 30.0, 12)
    wrench[[2, 8]] = 160.0
    wrench *= np.repeat(stands, 6)
    other = np.array([20.0, -10.0, 80.0])
    terms = dynamics.terms(state, given, state.dq, other, stands)
    legs, others, base = terms.leg_tau, terms.other_tau, terms.base_acc
    tau = np.concatenate([legs[0] @ wrench + legs[1], others[0] @ wrench + others[1]])

    spec = mujoco_spec(ROBOT, floating=True, shapes=False)
    model = spec.compile()
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in JOINT_NAMES]
    dofs = [joint.dofadr[0] for joint in joints]
    data.qpos[3:7] = state.quat_wxyz
    data.qpos[[joint.qposadr[0] for joint in joints]] = state.q
    # The base moves so that the soles have no velocity, as far as both feet together can.
    data.qvel[3:6], data.qvel[dofs] = state.ang_vel, state.dq
    mujoco.mj_forward(model, data)
    data.qfrc_applied[:3] = other
    data.qfrc_applied[dofs] = tau - friction_torque(state.dq)
    feet = [model.body(f"{side}_ankle_roll_link").id for side in ("left", "right")]
    for foot, sole, part in zip(feet, terms.soles, wrench.reshape(2, 6), strict=True):
        mujoco.mj_applyFT(model, data, part[:3], part[3:], sole, foot, data.qfrc_applied)
    mujoco.mj_forward(model, data)
    led = np.concatenate([np.repeat(stands, LEGS // 2), np.zeros(29 - LEGS, bool)])
    assert data.qacc[dofs][~led] == pytest.approx(given[~led], abs=1e-6)
    assert data.qacc[:6] == pytest.approx(base[0] @ wrench + base[1], abs=1e-4)
    for foot, sole in zip(np.array(feet)[[*stands]], terms.soles[[*stands]], strict=True):
        jac, rate = np.zeros((2, 6, model.nv))
        mujoco.mj_jac(model, data, jac[:3], jac[3:], sole, foot)
        mujoco.mj_jacDot(model, data, rate[:3], rate[3:], sole, foot)
        assert jac @ data.qacc + rate @ data.qvel == pytest.approx(np.zeros(6), abs=2e-3)


def test_a_reference_at_rest_takes_its_weight(dynamics, state):
    still = state._replace(ang_vel=np.zeros(3), dq=np.zeros(29))
    acc = np.zeros(3), np.zeros(3), np.zeros(29)
    movement = dynamics.movement(still, np.array([0.1, 0.2, 0.7]), np.zeros(3), acc)
    assert movement.force == pytest.approx([0.0, 0.0, dynamics.weight])
    assert movement.vel == pytest.approx(np.zeros(3))
    terms = dynamics.terms(still, np.zeros(29), still.dq, np.zeros(3))
    assert terms.centre + np.array([0.1, 0.2, 0.7]) == pytest.approx(movement.pos)
