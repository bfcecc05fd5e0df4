from types import SimpleNamespace
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.errors import RobotError
from g1stream.robot.dynamics import BaseMotion, InverseDynamics, friction_torque
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1

GRAVITY = np.array([0.0, 0.0, 9.81])
UPRIGHT = BaseMotion(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))


@pytest.fixture(scope="module")
def inverse(robot):
    return InverseDynamics(robot)


@pytest.fixture
def moving(robot):
    """A pose, a velocity, an acceleration of the joints, and a tilted base that turns."""
    rng = np.random.default_rng(5)
    quat = Rotation.from_euler("xyz", [0.2, -0.3, 1.0]).as_quat()[[3, 0, 1, 2]]
    return SimpleNamespace(
        q=(robot.lower + robot.upper) / 2 + 0.2 * rng.normal(size=N_JOINTS),
        dq=rng.normal(size=N_JOINTS),
        ddq=5.0 * rng.normal(size=N_JOINTS),
        base=BaseMotion(quat, rng.normal(size=3)),
    )


@pytest.mark.parametrize("support", ["bolted", "hanging", "free", "follow"])
def test_in_mujoco_the_torques_cause_the_accelerations(
    robot, inverse, moving, compile_mujoco, support
):
    """And the accelerometer's reading, in a model of the URDF that has no friction."""
    base = moving.base._replace(lin_acc=np.array([0.5, 1.0, -2.0]), ang_acc=np.array([3.0, 2, 1]))
    solution = inverse.solve(support, moving.q, moving.dq, moving.ddq, base)
    model = compile_mujoco(robot.urdf)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    joints = [model.joint(name) for name in JOINT_NAMES]
    dofs = [joint.dofadr[0] for joint in joints]
    model.dof_armature[dofs] = ARMATURE
    data = mujoco.MjData(model)
    data.qpos[3:7], data.qvel[3:6] = base.quat_wxyz, base.ang_vel
    data.qpos[[joint.qposadr[0] for joint in joints]] = moving.q
    data.qvel[dofs] = moving.dq
    mujoco.mj_forward(model, data)
    weight = model.body_mass.sum() * GRAVITY
    assert inverse.mass == pytest.approx(weight[2] / 9.81)
    if support == "hanging":
        torso = model.body_weldid == model.body("torso_link").id
        centre = np.average(data.xipos[torso], axis=0, weights=model.body_mass[torso])
        carrier = model.body("torso_link").id
        mujoco.mj_applyFT(model, data, weight, np.zeros(3), centre, carrier, data.qfrc_applied)
    data.qfrc_applied[dofs] += solution.tau - friction_torque(moving.dq)
    data.qfrc_applied[:6] += solution.wrench
    mujoco.mj_forward(model, data)
    assert data.qacc[dofs] == pytest.approx(moving.ddq, abs=1e-8)
    assert data.qacc[:3] == pytest.approx(solution.lin_acc, abs=1e-8)
    assert data.qacc[3:6] == pytest.approx(solution.ang_acc, abs=1e-8)
    given = {"bolted": np.zeros(3), "follow": base.lin_acc}
    assert solution.lin_acc == pytest.approx(given.get(support, solution.lin_acc))
    assert (np.abs(solution.wrench).max() > 1.0) == (support in given)
    mujoco.mj_rnePostConstraint(model, data)
    felt, imu = np.zeros(6), model.body("imu_in_pelvis").id
    mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_XBODY, imu, felt, 1)
    assert inverse.specific_force(solution, base) == pytest.approx(felt[3:], abs=1e-8)


def test_a_given_force_replaces_the_weight(inverse, moving):
    arguments = moving.q, moving.dq, moving.ddq, moving.base
    weight = inverse.solve("hanging", *arguments, force=inverse.mass * GRAVITY)
    assert weight.tau == pytest.approx(inverse.solve("hanging", *arguments).tau, abs=1e-9)
    nothing = inverse.solve("hanging", *arguments, force=np.zeros(3))
    assert nothing.tau == pytest.approx(inverse.solve("free", *arguments).tau, abs=1e-9)


def test_the_accelerometer_does_not_depend_on_the_last_solution(inverse, moving):
    on_its_side = BaseMotion(np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]), np.zeros(3))
    still = (moving.q, np.zeros(29), np.zeros(29))
    upright = inverse.solve("bolted", *still, UPRIGHT)
    lying = inverse.solve("bolted", *still, on_its_side)
    assert inverse.specific_force(upright, UPRIGHT) == pytest.approx(GRAVITY, abs=1e-9)
    assert inverse.specific_force(lying, on_its_side) == pytest.approx([0.0, 9.81, 0.0], abs=1e-9)


def test_friction_opposes_every_joint_once_it_moves():
    fast = friction_torque(np.full(29, 1.0))
    assert fast == pytest.approx(FRICTION + DAMPING, rel=1e-6)
    assert friction_torque(np.full(29, -1.0)).tolist() == (-fast).tolist()
    assert not friction_torque(np.zeros(29)).any()


def test_an_unknown_carrier_is_named(robot):
    with pytest.raises(RobotError, match="no link 'hook'"):
        InverseDynamics(robot, carrier="hook")


def test_a_urdf_without_masses_is_named(robot):
    root = ET.fromstring(robot.urdf)
    for link in root.iter("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    with pytest.raises(RobotError, match="weightless"):
        InverseDynamics(G1.from_urdf(ET.tostring(root, encoding="unicode"), "weightless"))
