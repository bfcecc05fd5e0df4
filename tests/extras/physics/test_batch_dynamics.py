import mujoco
import numpy as np
import pytest

from g1stream.extras.physics.batch_dynamics import BatchInverseDynamics
from g1stream.robot.dynamics import BaseMotion, InverseDynamics, mujoco_spec
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_normalize, quat_rotate, tilt_of

N = 12
TORQUE = 1e-9  # N·m, N
STILL = np.zeros(3)


@pytest.fixture(scope="module", params=[None, "g1_29dof", "g1_23dof", "with hands"])
def pair(request, reference_urdf):
    """A robot, its dynamics in frames, and MuJoCo's."""
    name = request.param
    if name == "with hands":
        name = reference_urdf("g1_29dof_with_hand_rev_1_0.urdf")
    robot = G1.load(name)
    return robot, BatchInverseDynamics(robot), InverseDynamics(robot)


@pytest.fixture
def movement(pair):
    """Positions, velocities, accelerations (N, 29), and motions of the pelvis."""
    robot, rng = pair[0], np.random.default_rng(7)
    low, high = robot.lower.clip(-3.0, 3.0), robot.upper.clip(-3.0, 3.0)
    q = np.where(robot.present, rng.uniform(low, high, (N, N_JOINTS)), 0.0)
    dq, ddq = 3.0 * rng.normal(size=(N, N_JOINTS)), 20.0 * rng.normal(size=(N, N_JOINTS))
    quat = quat_normalize(rng.normal(size=(N, 4)))
    return q, dq, ddq, [BaseMotion(one, *rng.normal(size=(3, 3))) for one in quat]


def frames_of(pair, movement):
    q, dq, ddq, bases = movement
    quat = np.array([base.quat_wxyz for base in bases])
    pos = np.random.default_rng(8).normal(size=(N, 3))
    return pair[1].batch(forward_kinematics(pair[0], q, pos, quat), dq, ddq)


def test_bolted_torques_are_those_of_mujoco(pair, movement):
    upright = BaseMotion(np.array([1.0, 0.0, 0.0, 0.0]), STILL)
    expected = [
        pair[2].solve("bolted", *one, upright).tau for one in zip(*movement[:3], strict=True)
    ]
    np.testing.assert_allclose(frames_of(pair, movement).bolted(), expected, atol=TORQUE)
    assert pair[1].mass == pytest.approx(pair[2].mass)


def test_hanging_torques_and_tilt_are_those_of_mujoco(pair, movement):
    """In MuJoCo the pelvis is turned until the mass centre is below the carrier's."""
    tau, tilt = frames_of(pair, movement).hanging()
    upright = BaseMotion(np.array([1.0, 0.0, 0.0, 0.0]), STILL)
    for k, (q, dq, ddq) in enumerate(zip(*movement[:3], strict=True)):
        x, y, z = pair[2].momentum(q, np.zeros(N_JOINTS), upright).lever
        turn = quat_normalize(np.array([np.linalg.norm([x, y, z]) + z, y, -x, 0.0]))
        expected = pair[2].solve("hanging", q, dq, ddq, BaseMotion(turn, STILL)).tau
        np.testing.assert_allclose(tau[k], expected, atol=TORQUE)
        assert tilt[k] == pytest.approx(tilt_of(turn), abs=1e-7)


def test_what_a_given_pelvis_takes_is_what_mujoco_says(pair, movement):
    bases = movement[3]
    columns = [[getattr(b, name) for b in bases] for name in ("ang_vel", "ang_acc", "lin_acc")]
    loads = frames_of(pair, movement).follow(*map(np.array, columns))
    for k, one in enumerate(zip(*movement, strict=True)):
        expected = pair[2].solve("follow", *one)
        np.testing.assert_allclose(loads.tau[k], expected.tau, atol=TORQUE)
        np.testing.assert_allclose(loads.force[k], expected.wrench[:3], atol=TORQUE)
        moment = quat_rotate(bases[k].quat_wxyz, expected.wrench[3:])
        np.testing.assert_allclose(loads.moment[k], moment, atol=TORQUE)


def test_torques_of_forces_on_links_are_those_of_mujoco(robot):
    rng = np.random.default_rng(9)
    joint_pos = rng.uniform(robot.lower, robot.upper)
    root = np.array([0.4, -0.3, 0.7, 0.8, 0.0, 0.6, 0.0])
    poses = forward_kinematics(robot, joint_pos[np.newaxis], root[:3], root[3:])
    links = [robot.link_index(f"{side}_ankle_roll_link") for side in ("left", "right", "left")]
    points = poses.pos[:, links] + 0.1 * rng.normal(size=(1, 3, 3))
    pushes = 50 * rng.normal(size=(1, 3, 3))
    model = mujoco_spec(robot, floating=True, shapes=False).compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in JOINT_NAMES]
    data.qpos[:7] = root
    data.qpos[[joint.qposadr[0] for joint in joints]] = joint_pos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    expected, jacobian = np.zeros(N_JOINTS), np.zeros((3, model.nv))
    for link, point, push in zip(links, points[0], pushes[0], strict=True):
        body = model.body(robot.link_names[link]).id
        mujoco.mj_jac(model, data, jacobian, None, point, body)
        expected += (jacobian.T @ push)[[joint.dofadr[0] for joint in joints]]
    still = np.zeros((1, N_JOINTS))
    frames = BatchInverseDynamics(robot).batch(poses, still, still)
    assert frames.torques_of(links, points, pushes)[0] == pytest.approx(expected, abs=1e-9)
    assert np.abs(expected[:12]).min() > 0
    assert not expected[12:].any()
