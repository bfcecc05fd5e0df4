"""The simulated robot against mechanics done without MuJoCo, and against its own promises."""

from __future__ import annotations

import csv
import sysconfig
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from g1stream.errors import SimError
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_rotate, quat_rotate_inverse
from g1stream.sim.model import TORQUE_LIMIT
from g1stream.sim.world import MotorCommand, World

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

LAFAN = Path(__file__).parents[2].parent / "shared" / "lafan1" / "joints_labeled.csv"
UNITREE_URDFS = Path(
    sysconfig.get_path("purelib"),
    "cmeel.prefix/share/example-robot-data/robots/g1_description/urdf",
)
GRAVITY = 9.81


@pytest.fixture
def robot() -> G1:
    return G1.default()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def servo(
    q: ArrayLike = 0.0,
    dq: ArrayLike = 0.0,
    tau: ArrayLike = 0.0,
    kp: ArrayLike = EXAMPLE_KP,
    kd: ArrayLike = EXAMPLE_KD,
    enabled: ArrayLike = True,
) -> MotorCommand:
    numbers = (np.broadcast_to(value, N_JOINTS).astype(float) for value in (q, dq, tau, kp, kd))
    return MotorCommand(np.broadcast_to(enabled, N_JOINTS), *numbers)


def run(world: World, command: MotorCommand, seconds: float) -> None:
    for _ in range(round(seconds / world.timestep)):
        world.step(command)


def inner_pose(robot: G1, rng: np.random.Generator) -> NDArray[np.float64]:
    """A pose well inside every joint's limits."""
    middle, span = (robot.lower + robot.upper) / 2, robot.upper - robot.lower
    return middle + span * rng.uniform(-0.3, 0.3, N_JOINTS)


def potential_energy(robot: G1, joint_pos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of poses (T, 29), J, from the URDF's masses and our own kinematics, pelvis at the origin."""
    n_poses = len(joint_pos)
    links = forward_kinematics(
        robot, joint_pos, np.zeros((n_poses, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (n_poses, 1))
    )
    energy = np.zeros(n_poses)
    for link, mass, centre in masses(robot):
        index = robot.link_index(link)
        height = links.pos[:, index] + quat_rotate(links.quat_wxyz[:, index], centre)
        energy += mass * GRAVITY * height[:, 2]
    return energy


def masses(robot: G1) -> list[tuple[str, float, NDArray[np.float64]]]:
    """Each link's name, mass and centre of mass in its own frame, as the URDF has them."""
    found = []
    for link in ET.fromstring(robot.urdf).iter("link"):
        mass, origin = link.find("inertial/mass"), link.find("inertial/origin")
        if mass is not None and origin is not None:
            centre = np.array([float(part) for part in origin.attrib["xyz"].split()])
            found.append((link.attrib["name"], float(mass.attrib["value"]), centre))
    return found


def gravity_torque(robot: G1, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The torque (29,) that holds a pose still, N·m: the slope of the potential energy."""
    step = 1e-5
    poses = pose + step * np.concatenate([np.eye(N_JOINTS), -np.eye(N_JOINTS)])
    up, down = potential_energy(robot, poses).reshape(2, N_JOINTS)
    return (up - down) / (2 * step)


def base_tilt(quat_wxyz: NDArray[np.float64]) -> float:
    """Angle between the base's z axis and the world's, rad."""
    return float(np.arccos(quat_rotate(quat_wxyz, np.array([0.0, 0.0, 1.0]))[2]))


def test_servo_law_and_torque_limits(robot: G1, rng: np.random.Generator) -> None:
    world = World(robot, joint_pos=inner_pose(robot, rng))
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
        wanted = (
            command.tau
            + command.kp * (command.q - before.q)
            + command.kd * (command.dq - before.dq)
        )
        applied = world.state().tau_est
        assert applied == pytest.approx(np.clip(wanted, -TORQUE_LIMIT, TORQUE_LIMIT), abs=1e-9)
        saturated |= np.abs(applied) == TORQUE_LIMIT
    assert saturated.all()


def test_torque_limits_are_those_of_unitree_mujoco(robot: G1) -> None:
    kinds = {
        "hip": 88,
        "knee": 139,
        "ankle": 50,
        "waist_yaw": 88,
        "waist_roll": 50,
        "waist_pitch": 50,
        "shoulder": 25,
        "elbow": 25,
        "wrist_roll": 25,
        "wrist_pitch": 5,
        "wrist_yaw": 5,
    }
    world = World(robot)
    world.step(servo(tau=1000.0, kp=0.0, kd=0.0))
    felt = world.data.qfrc_actuator[[world.model.joint(name).dofadr[0] for name in JOINT_NAMES]]
    for motor, name in enumerate(JOINT_NAMES):
        (limit,) = (limit for kind, limit in kinds.items() if kind in name)
        assert world.state().tau_est[motor] == felt[motor] == limit, name


def test_joint_mechanics_are_those_of_unitree_mujoco(robot: G1) -> None:
    model = World(robot).model
    for name in JOINT_NAMES:
        dof = model.joint(name).dofadr[0]
        assert model.dof_armature[dof] == 0.01, name
        assert model.dof_damping[dof] == 0.05, name
        small = "wrist_pitch" in name or "wrist_yaw" in name
        assert model.dof_frictionloss[dof] == (0.1 if small else 0.2), name


def test_acceleration_agrees_with_inverse_dynamics(robot: G1, rng: np.random.Generator) -> None:
    world = World(robot, joint_pos=inner_pose(robot, rng))
    run(world, servo(kp=20.0), 0.05)
    inverse = mujoco.MjData(world.model)
    inverse.qpos, inverse.qvel = world.data.qpos, world.data.qvel
    world.step(servo(q=rng.uniform(-0.5, 0.5, N_JOINTS)))
    after = world.state()
    dofs = [world.model.joint(name).dofadr[0] for name in JOINT_NAMES]
    inverse.qacc[dofs] = after.ddq
    mujoco.mj_inverse(world.model, inverse)
    assert inverse.qfrc_inverse[dofs] == pytest.approx(after.tau_est, abs=1e-3)


def test_pose_is_held_with_the_static_error_that_kp_predicts(
    robot: G1, rng: np.random.Generator
) -> None:
    target = inner_pose(robot, rng)
    world = World(robot, joint_pos=target)
    world.model.dof_frictionloss[:] = 0  # it would hold the joints anywhere near
    kp = np.full(N_JOINTS, 100.0)
    run(world, servo(q=target, kp=kp, kd=10.0), 3.0)
    at_rest = world.state()
    assert np.abs(at_rest.dq).max() < 1e-4
    holding = gravity_torque(robot, at_rest.q)
    assert np.abs(holding).max() > 5  # or the pose would ask for nothing
    assert target - at_rest.q == pytest.approx(holding / kp, abs=1e-5)
    assert at_rest.tau_est == pytest.approx(holding, abs=1e-3)


def test_limp_robot_gets_no_torque_and_loses_energy(robot: G1, rng: np.random.Generator) -> None:
    world = World(robot, joint_pos=inner_pose(robot, rng))
    limp = servo(q=1.0, tau=5.0, enabled=False)
    energy = []
    for _ in range(2000):
        world.step(limp)
        assert not world.state().tau_est.any()
        mujoco.mj_energyPos(world.model, world.data)
        mujoco.mj_energyVel(world.model, world.data)
        energy.append(world.data.energy.sum())
    assert np.diff(energy).max() < 0.01
    assert energy[-1] < energy[0] - 1


def test_a_free_pendulum_keeps_its_energy(robot: G1) -> None:
    world = World(robot, joint_pos=np.where(np.array(JOINT_NAMES) == "left_knee_joint", 0.8, 0.0))
    world.model.dof_frictionloss[:] = 0
    world.model.dof_damping[:] = 0
    world.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT  # a limit hit eats energy
    start = potential_energy(robot, world.state().q[None])[0]
    lost, swing = [], []
    for _ in range(300):
        world.step(MotorCommand.off())
        state = world.state()
        mujoco.mj_energyVel(world.model, world.data)
        kinetic = world.data.energy[1]
        lost.append(start - potential_energy(robot, state.q[None])[0] - kinetic)
        swing.append(kinetic)
    assert max(swing) > 1
    assert np.abs(lost).max() < 0.02 * max(swing)


def test_only_enabled_motors_move(robot: G1) -> None:
    enabled = np.arange(N_JOINTS) % 2 == 0
    world = World(robot)
    world.step(servo(tau=3.0, kp=0.0, kd=0.0, enabled=enabled))
    assert (world.state().tau_est == np.where(enabled, 3.0, 0.0)).all()


@pytest.mark.parametrize("motor", range(N_JOINTS))
def test_motor_order_is_joint_order(robot: G1, motor: int) -> None:
    world = World(robot)
    world.step(MotorCommand.off())
    at_rest = world.state().ddq
    world = World(robot)
    world.step(servo(tau=4.0 * (np.arange(N_JOINTS) == motor), kp=0.0, kd=0.0))
    pushed = world.state().ddq - at_rest
    joint = world.model.joint(JOINT_NAMES[motor])
    assert pushed[motor] > 5
    assert world.data.qacc[joint.dofadr[0]] == pytest.approx(pushed[motor] + at_rest[motor])


def test_links_may_come_in_any_order(robot: G1) -> None:
    urdf = ET.fromstring(robot.urdf)
    urdf[:] = reversed(urdf)
    shuffled = replace(robot, urdf=ET.tostring(urdf, encoding="unicode"))
    one, other = World(robot), World(shuffled)
    names = [[world.model.joint(i).name for i in range(N_JOINTS)] for world in (one, other)]
    assert names[0] != names[1]
    command = servo(q=np.linspace(-0.3, 0.3, N_JOINTS))
    for world in (one, other):
        run(world, command, 0.2)
    assert other.state().q == pytest.approx(one.state().q, abs=1e-6)
    assert other.state().tau_est == pytest.approx(one.state().tau_est, abs=1e-3)


def test_imu_at_rest_reads_gravity_upward(robot: G1) -> None:
    state = World(robot).state()
    assert state.imu.quat_wxyz == pytest.approx([1, 0, 0, 0])
    assert state.imu.gyroscope == pytest.approx([0, 0, 0])
    assert state.imu.accelerometer == pytest.approx([0, 0, GRAVITY])


def test_torso_imu_turns_with_the_waist(robot: G1) -> None:
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


def test_velocities_are_the_slopes_of_positions_at_the_same_time(robot: G1) -> None:
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


def test_hanging_robot_settles_upright_where_the_band_carries_it(robot: G1) -> None:
    world = World(robot, "hanging")
    weight = GRAVITY * sum(mass for _, mass, _ in masses(robot))
    height, tilt = [], []
    for _ in range(4000):
        world.step(servo())
        height.append(world.state().base_pos[2])
        tilt.append(base_tilt(world.state().imu.quat_wxyz))
    assert np.mean(height[2000:]) == pytest.approx(3 - weight / 200, abs=0.003)
    assert np.ptp(height[2000:]) < 0.01
    assert max(tilt) < 0.15


def test_band_pulls_at_the_torso_by_its_law(robot: G1) -> None:
    """Newton and Euler on the whole robot: what changes its momenta must be band and weight."""
    world = World(robot, "hanging", base_height=1.1)
    world.data.qpos[0] = 0.5  # so that it pulls sideways too, and turns the robot
    run(world, servo(q=0.2), 0.2)
    model, data = world.model, world.data

    def momenta() -> NDArray[np.float64]:
        mujoco.mj_subtreeVel(model, data)
        return np.concatenate(
            [model.body_subtreemass[1] * data.subtree_linvel[1], data.subtree_angmom[1]]
        )

    state, start = world.state(), momenta()
    torso = [model.body(name).id for name in ("torso_link", "head_link", "logo_link")]
    centre = np.average(data.xipos[torso], axis=0, weights=model.body_mass[torso])
    arm = centre - data.subtree_com[1]
    world.step(servo(q=0.2))
    force, moment = ((momenta() - start) / world.timestep).reshape(2, 3)

    to_top = np.array([0.0, 0.0, 3.0]) - state.base_pos
    length = np.linalg.norm(to_top)
    speed = state.base_lin_vel @ to_top / length
    band = (200 * length - 100 * speed) * to_top / length
    assert abs(speed) > 0.1
    weight = np.array([0.0, 0.0, -GRAVITY * model.body_subtreemass[1]])
    assert force == pytest.approx(band + weight, abs=0.002 * np.linalg.norm(band))
    assert moment == pytest.approx(np.cross(arm, band), abs=0.002 * np.linalg.norm(band))


@pytest.mark.parametrize("support", ["bolted", "hanging"])
def test_same_commands_give_the_same_bits(robot: G1, support: str) -> None:
    def play() -> bytes:
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


def test_trajectory_converges_with_the_timestep(robot: G1) -> None:
    """To first order, so half the timestep has half the error."""

    def play(timestep: float) -> NDArray[np.float64]:
        world = World(robot, timestep=timestep)
        poses = []
        for tick in range(50):
            run(world, servo(q=0.3 * np.sin(0.2 * tick)), 0.01)
            poses.append(world.state().q)
        return np.array(poses)

    fine = play(5e-5)
    errors = [float(np.sqrt(np.mean((play(dt) - fine) ** 2))) for dt in (2e-3, 1e-3, 5e-4)]
    assert errors[1] < 0.01 * np.sqrt(np.mean(fine**2))
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(2, rel=0.2)


@pytest.mark.parametrize("kd", [10.0, 50.0])
def test_strong_damping_does_not_chatter(robot: G1, kd: float) -> None:
    world = World(robot, joint_pos=np.full(N_JOINTS, 0.1))
    run(world, servo(kp=20.0, kd=kd), 0.5)
    speeds = []
    for _ in range(200):
        world.step(servo(kp=20.0, kd=kd))
        speeds.append(world.state().dq)
    assert np.abs(np.diff(speeds, axis=0)).max() < 0.01


def test_float32_commands_are_obeyed_alike(robot: G1, rng: np.random.Generator) -> None:
    exact = servo(q=rng.uniform(-0.3, 0.3, N_JOINTS), tau=0.7)
    wire = MotorCommand(exact.enabled, *(values.astype(np.float32) for values in exact[1:]))
    worlds = World(robot), World(robot)
    for world, command in zip(worlds, (exact, wire), strict=True):
        run(world, command, 0.1)
    assert worlds[1].state().q == pytest.approx(worlds[0].state().q, abs=1e-6)


def test_robot_meets_the_floor_but_not_itself(robot: G1, rng: np.random.Generator) -> None:
    for _ in range(20):
        pose = rng.uniform(robot.lower, robot.upper)
        assert World(robot, joint_pos=pose, base_height=2.0).data.ncon == 0
    low = World(robot, base_height=0.78)
    feet = {
        low.model.body(low.model.geom_bodyid[pair.max()]).name for pair in low.data.contact.geom
    }
    assert feet == {"left_ankle_roll_link", "right_ankle_roll_link"}
    assert World(robot).data.ncon == 0


def test_feet_stop_at_the_floor(robot: G1) -> None:
    """A robot bolted too low for its legs cannot stretch them."""
    bent = np.zeros(N_JOINTS)
    for side in ("left", "right"):
        for joint, angle in (("hip_pitch", -0.8), ("knee", 1.6), ("ankle_pitch", -0.8)):
            bent[JOINT_NAMES.index(f"{side}_{joint}_joint")] = angle
    world = World(robot, joint_pos=bent, base_height=0.7)
    assert world.data.ncon == 0
    run(world, servo(), 1.0)
    soles = [world.data.geom_xpos[i][2] for i in feet(world)]
    assert min(soles) > 0
    assert world.data.ncon > 0


def feet(world: World) -> list[int]:
    """The shapes of the feet that meet the floor."""
    return [
        geom
        for geom in range(world.model.ngeom)
        if world.model.geom_conaffinity[geom]
        and "ankle_roll" in world.model.body(world.model.geom_bodyid[geom]).name
    ]


def test_start_pose_and_height(robot: G1, rng: np.random.Generator) -> None:
    pose = inner_pose(robot, rng)
    for support in ("bolted", "hanging"):
        state = World(robot, support, joint_pos=pose, base_height=1.2).state()
        assert state.q == pytest.approx(pose, abs=1e-15)
        assert state.base_pos == pytest.approx([0, 0, 1.2])
        assert state.time == 0


def test_states_are_the_callers_own(robot: G1) -> None:
    world = World(robot)
    first = world.state()
    run(world, MotorCommand.off(), 0.1)
    assert first.time == 0
    assert not first.q.any()
    assert first.imu.accelerometer == pytest.approx([0, 0, GRAVITY])


@pytest.mark.parametrize("name", ["g1_29dof_rev_1_0", "g1_29dof_with_hand_rev_1_0"])
def test_urdf_with_meshes_and_fingers(name: str) -> None:
    urdf = UNITREE_URDFS / f"{name}.urdf"
    if not urdf.exists():
        pytest.skip(f"{name} is in example-robot-data, of the extra `meshes`")
    world = World(G1.load(urdf), "hanging")
    assert world.model.nv == 6 + N_JOINTS
    assert world.model.nmesh == 0
    run(world, servo(), 0.1)
    assert np.isfinite(world.state().q).all()


def altered(robot: G1, old: str, new: str) -> G1:
    assert old in robot.urdf
    return replace(robot, source="mine.urdf", urdf=robot.urdf.replace(old, new))


def test_without_imu_frames_they_sit_in_pelvis_and_torso(robot: G1) -> None:
    renamed = altered(robot, "imu_in_", "frame_in_")
    state = World(renamed).state()
    assert state.imu.accelerometer == pytest.approx([0, 0, GRAVITY])
    model = World(renamed).model
    assert model.body(model.site("secondary_imu").bodyid[0]).name == "torso_link"


def test_link_without_mass_is_refused(robot: G1) -> None:
    with pytest.raises(SimError, match=r"mine\.urdf: .*moving bodies.*needs a mass"):
        World(altered(robot, '<mass value="1.932"', '<mass value="0"'))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"support": "floating"}, "'floating'. Choose from bolted, hanging"),
        ({"joint_pos": np.zeros(23)}, r"shape \(23,\)"),
        ({"joint_pos": np.full(N_JOINTS, np.nan)}, "29 finite angles"),
        ({"timestep": 0.0}, "timestep of 0.0"),
        ({"base_height": float("inf")}, "base height of inf"),
    ],
)
def test_impossible_worlds_are_refused(
    robot: G1, arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(SimError, match=message):
        World(robot, **arguments)


def test_command_that_is_not_finite_is_refused(robot: G1) -> None:
    world = World(robot)
    command = servo()
    command.q[JOINT_NAMES.index("left_knee_joint")] = np.nan
    with pytest.raises(SimError, match="left_knee_joint is not finite"):
        world.step(command)
    world.step(servo())
    assert np.isfinite(world.state().q).all()


def test_state_that_cannot_be_integrated_is_told(
    robot: G1, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log there
    world = World(robot)
    run(world, servo(), 0.01)
    world.data.qvel[:] = 1e12
    with pytest.raises(SimError, match=r"back to its start at 0\.010 s"):
        world.step(servo())


@pytest.mark.skipif(not LAFAN.exists(), reason=f"the dance is not in {LAFAN.parent.name}/")
@pytest.mark.parametrize(("support", "worst"), [("bolted", 0.09), ("hanging", 0.047)])
def test_dance_is_followed_as_by_unitree_mujoco(robot: G1, support: str, worst: float) -> None:
    """Unitree's gains, q and dq at 500 Hz; the bounds are what their simulators reach."""
    fps = 30
    with LAFAN.open() as file:
        rows = list(csv.reader(file))
    assert tuple(rows[0][8:]) == JOINT_NAMES
    frames = np.array(rows[1:602], dtype=float)[:, 8:]
    world = World(robot, support, joint_pos=frames[0])
    errors = []
    for tick in range(round(500 * (len(frames) - 1) / fps)):
        index, part = divmod(tick / 500 * fps, 1)
        here, there = frames[int(index)], frames[int(index) + 1]
        q = here + part * (there - here)
        errors.append(world.state().q - q)
        run(world, servo(q=q, dq=(there - here) * fps), 1 / 500)
    assert np.sqrt(np.mean(np.square(errors))) < worst
