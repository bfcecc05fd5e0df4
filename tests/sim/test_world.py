import mujoco
import numpy as np
import pytest

from g1stream.errors import SimError
from g1stream.motion.readers import load_motion
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.joints import DAMPING, JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.rotations import quat_from_axis_angle, quat_rotate, quat_rotate_inverse
from g1stream.sim.model import TORQUE_LIMIT
from g1stream.sim.world import MotorCommand, Root, World

GRAVITY = 9.81


def test_servo_law_and_torque_limits(robot, rng, servo, inner_pose):
    world = World(robot, joint_pos=inner_pose)
    saturated = np.zeros(N_JOINTS, dtype=bool)
    for _ in range(200):
        command = servo(
            q=rng.uniform(-2, 2, N_JOINTS),
            dq=rng.uniform(-5, 5, N_JOINTS),
            tau=rng.uniform(-10, 10, N_JOINTS),
            kp=rng.uniform(0, 100, N_JOINTS),
            kd=rng.uniform(0, 5, N_JOINTS),
        )
        before = world.state()
        world.step(command)
        after = world.state()
        asked = (
            command.tau
            + command.kp * (command.q - before.q)
            + command.kd * (command.dq - before.dq)
        )
        limited = np.abs(asked) >= TORQUE_LIMIT
        damped = asked - command.kd * (after.dq - before.dq)  # that damping is implicit
        wanted = np.where(limited, np.clip(asked, -TORQUE_LIMIT, TORQUE_LIMIT), damped)
        assert after.tau_est == pytest.approx(wanted, abs=1e-9)
        saturated |= limited
    assert saturated.all()


def test_only_enabled_motors_move(robot, servo):
    enabled = np.arange(N_JOINTS) % 2 == 0
    world = World(robot)
    world.step(servo(q=1.0, dq=1.0, tau=3.0, enabled=enabled))
    assert ((world.state().tau_est != 0.0) == enabled).all()


def test_torso_imu_turns_with_the_waist(robot, servo, run):
    pose = np.zeros(N_JOINTS)
    pose[[JOINT_NAMES.index("waist_yaw_joint"), JOINT_NAMES.index("waist_pitch_joint")]] = 0.7, 0.4
    world = World(robot, joint_pos=pose)
    run(world, servo(q=pose, kp=200.0, kd=10.0), 3.0)
    state = world.state()
    torso = forward_kinematics(
        robot, state.q[None], np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    ).quat_wxyz[0, robot.link_index("imu_in_torso")]
    assert state.torso_imu.quat_wxyz == pytest.approx(torso, abs=1e-9)
    assert state.torso_imu.quat_wxyz[3] > 0.3  # mostly about z, the last in wxyz
    upward = quat_rotate_inverse(torso, np.array([0.0, 0.0, GRAVITY]))
    assert state.torso_imu.accelerometer == pytest.approx(upward, abs=1e-2)
    world.step(servo(tau=20.0 * (np.array(JOINT_NAMES) == "waist_yaw_joint")))
    world.step(servo(tau=20.0 * (np.array(JOINT_NAMES) == "waist_yaw_joint")))
    moved = world.state()
    in_world = quat_rotate(moved.torso_imu.quat_wxyz, moved.torso_imu.gyroscope)
    assert in_world[2] == pytest.approx(moved.dq[JOINT_NAMES.index("waist_yaw_joint")], rel=0.1)
    assert abs(in_world[2]) > 0.01


@pytest.mark.parametrize("support", ["bolted", "hanging"])
def test_same_commands_give_the_same_bits(robot, support, servo):
    def play():
        rng = np.random.default_rng(3)
        world, states = World(robot, support), b""
        for _ in range(200):
            world.step(servo(q=rng.uniform(-0.3, 0.3, N_JOINTS)))
            states += b"".join(
                np.asarray(part).tobytes()
                for field in world.state()
                for part in (field if isinstance(field, tuple) else (field,))
            )
        return states

    assert play() == play()


def test_states_are_the_callers_own(robot, run):
    world = World(robot)
    first = world.state()
    run(world, MotorCommand.off(), 0.1)
    assert first.time == 0
    assert not first.q.any()
    assert first.imu.accelerometer == pytest.approx([0, 0, GRAVITY])


def test_command_that_is_not_finite_is_refused(robot, servo):
    world = World(robot)
    command = servo()
    command.q[JOINT_NAMES.index("left_knee_joint")] = np.nan
    with pytest.raises(SimError, match="left_knee_joint"):
        world.step(command)
    world.step(servo())
    assert np.isfinite(world.state().q).all()


def test_a_state_that_cannot_be_integrated_is_an_error(robot, tmp_path, monkeypatch, servo, run):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log there
    world = World(robot)
    run(world, servo(), 0.01)
    world.data.qvel[:] = 1e12
    with pytest.raises(SimError, match=r"0\.010 s"):
        world.step(servo())


@pytest.mark.parametrize("kd", [0.0, 2.0, 1000.0])
def test_torque_and_velocities_agree_with_inverse_dynamics(robot, rng, servo, run, inner_pose, kd):
    """Also where damping is strong, and where a motor is at its limit, as most are with kd 1000."""
    world = World(robot, joint_pos=inner_pose)
    world.model.dof_frictionloss[:] = 0  # a constraint, whose force the solver only approaches
    run(world, servo(kp=20.0), 0.05)
    inverse = mujoco.MjData(world.model)
    inverse.qpos, inverse.qvel = world.data.qpos, world.data.qvel
    before = world.state()
    world.step(servo(q=rng.uniform(-0.5, 0.5, N_JOINTS), kd=kd, dq=rng.uniform(-1, 1, N_JOINTS)))
    after = world.state()
    change = after.dq - before.dq
    assert after.ddq == pytest.approx(change / world.timestep, abs=1e-9)
    dofs = [world.model.joint(name).dofadr[0] for name in JOINT_NAMES]
    inverse.qacc[dofs] = after.ddq
    mujoco.mj_inverse(world.model, inverse)
    needed = inverse.qfrc_inverse[dofs] + DAMPING * change  # the joints' own is implicit, too
    assert after.tau_est == pytest.approx(needed, abs=1e-3)


def test_pose_is_held_with_the_static_error_that_kp_predicts(robot, servo, run, inner_pose):
    world = World(robot, joint_pos=inner_pose)
    world.model.dof_frictionloss[:] = 0  # it would hold the joints anywhere near
    kp = np.full(N_JOINTS, 100.0)
    run(world, servo(q=inner_pose, kp=kp, kd=10.0), 3.0)
    at_rest = world.state()
    assert np.abs(at_rest.dq).max() < 1e-4
    base = BaseMotion(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
    still = np.zeros(N_JOINTS)
    holding = InverseDynamics(robot).solve("bolted", at_rest.q, still, still, base).tau
    assert np.abs(holding).max() > 5  # or the pose would ask for nothing
    assert inner_pose - at_rest.q == pytest.approx(holding / kp, abs=1e-5)
    assert at_rest.tau_est == pytest.approx(holding, abs=1e-3)


def test_velocities_are_the_slopes_of_positions_at_the_same_time(robot, servo, run):
    world = World(robot, "hanging", joint_pos=np.full(N_JOINTS, 0.1))
    run(world, servo(q=-0.1), 0.1)
    before = world.state()
    world.step(servo(q=-0.1))
    after = world.state()
    assert after.time - before.time == pytest.approx(world.timestep)
    assert (after.q - before.q) / world.timestep == pytest.approx(after.dq, abs=1e-9)
    assert (after.dq - before.dq) / world.timestep == pytest.approx(after.ddq, rel=0.2, abs=2.0)
    speed = (after.base_pos - before.base_pos) / world.timestep
    assert speed == pytest.approx(after.base_lin_vel, abs=1e-9)
    assert np.abs(speed).max() > 1e-3


@pytest.mark.slow
def test_dance_is_followed_as_by_unitree_mujoco(robot, real_clip, servo):
    """Unitree's gains, q and dq at 500 Hz; the bound is what their simulators reach."""
    fps, frames = 30, load_motion(real_clip).joint_pos[:601]
    world = World(robot, "hanging", joint_pos=frames[0])
    errors = []
    for tick in range(round(500 * (len(frames) - 1) / fps)):
        index, part = divmod(tick / 500 * fps, 1)
        here, there = frames[int(index)], frames[int(index) + 1]
        q = here + part * (there - here)
        errors.append(world.state().q - q)
        world.step(servo(q=q, dq=(there - here) * fps), 2)
    assert np.sqrt(np.mean(np.square(errors))) < 0.047


def test_the_accelerometer_of_a_bolted_robot_turns_with_its_base(robot):
    world, still = World(robot), np.zeros(3)
    for angle in (0.5, -0.3):
        quat = quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), np.asarray(angle))
        root = Root(np.array([0.0, 0.0, 1.5]), quat, still, still, playing=False)
        world.set_state(np.zeros(N_JOINTS), np.zeros(N_JOINTS), root)
        upward = quat_rotate_inverse(quat, np.array([0.0, 0.0, GRAVITY]))
        imu = world.state().imu
        assert imu.quat_wxyz == pytest.approx(quat)
        assert imu.accelerometer == pytest.approx(upward, abs=1e-6)
