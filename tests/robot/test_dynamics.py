from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.errors import RobotError
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import (
    BaseMotion,
    InverseDynamics,
    centres_of_mass,
    friction_torque,
)
from g1stream.robot.joints import ARMATURE, DAMPING, FRICTION, JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.parameters import NOMINAL
from g1stream.sim.world import Hanging, MotorCommand, World

GRAVITY = np.array([0.0, 0.0, 9.81])
UPRIGHT = BaseMotion(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
STEP = 1e-4


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


def bodies_of(robot):
    """Index, mass, mass centre and inertia about it, link frame, of each link that has mass."""
    for link in ET.fromstring(robot.urdf).iter("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        origin, tensor = inertial.find("origin").attrib, inertial.find("inertia").attrib
        turn = Rotation.from_euler("xyz", [float(x) for x in origin.get("rpy", "0 0 0").split()])
        rows = ("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz")
        matrix = np.array([[float(tensor[key]) for key in row] for row in rows])
        yield (
            robot.link_index(link.attrib["name"]),
            float(inertial.find("mass").attrib["value"]),
            np.array([float(x) for x in origin["xyz"].split()]),
            turn.as_matrix() @ matrix @ turn.as_matrix().T,
        )


class Path:
    """Momenta and energy of the robot on a path of joints and base, by differences of kinematics.

    The path has constant accelerations: of the joints, of the base's origin in the world, and of
    its rate in its own frame.
    """

    def __init__(self, robot, moving, lin_acc, ang_acc):
        self.robot, self.moving, self.bodies = robot, moving, list(bodies_of(robot))
        self.lin_acc, self.ang_acc = np.asarray(lin_acc), np.asarray(ang_acc)

    def poses(self, times):
        m, t = self.moving, np.asarray(times)[:, None]
        joints = m.q + t * m.dq + t**2 / 2 * m.ddq
        start = Rotation.from_quat(m.base.quat_wxyz[[1, 2, 3, 0]])
        # Magnus: to third order in t the turn of a rate w + a t is w t + a t^2/2 - a x w t^3/12 ...
        third = np.cross(m.base.ang_vel, self.ang_acc) / 12
        turn = start * Rotation.from_rotvec(
            t * m.base.ang_vel + t**2 / 2 * self.ang_acc + t**3 * third
        )
        quat = turn.as_quat()[:, [3, 0, 1, 2]]
        return forward_kinematics(self.robot, joints, t**2 / 2 * self.lin_acc, quat)

    def state(self, time):
        """Momentum, angular momentum about the mass centre, energy, mass centre at a time."""
        h = STEP
        poses = self.poses([time - h, time, time + h])
        momentum, spin, kinetic, height = np.zeros(3), np.zeros(3), 0.0, 0.0
        total, centre, parts = 0.0, np.zeros(3), []
        for index, mass, offset, inertia in self.bodies:
            turns = Rotation.from_quat(poses.quat_wxyz[:, index][:, [1, 2, 3, 0]])
            at = poses.pos[:, index] + turns.apply(offset)
            vel = (at[2] - at[0]) / (2 * h)
            rate = (turns[2] * turns[0].inv()).as_rotvec() / (2 * h)
            tensor = turns[1].as_matrix() @ inertia @ turns[1].as_matrix().T
            parts.append((mass, at[1], vel, tensor @ rate))
            momentum += mass * vel
            centre += mass * at[1]
            total += mass
            kinetic += (mass * vel @ vel + rate @ tensor @ rate) / 2
            height += mass * at[1][2]
        centre /= total
        for mass, at, vel, own in parts:
            spin += np.cross(at - centre, mass * vel) + own
        speed = self.moving.dq + time * self.moving.ddq
        kinetic += (ARMATURE * speed**2).sum() / 2
        return momentum, spin, kinetic + GRAVITY[2] * height, centre

    def rates(self):
        """Time derivatives of momentum, angular momentum and energy now; and the mass centre."""
        h = 10 * STEP
        before, now, after = self.state(-h), self.state(0.0), self.state(h)
        return *((b - a) / (2 * h) for a, b in list(zip(before, after, strict=True))[:3]), now[3]


def test_bolted_power_is_the_change_of_energy(robot, inverse, moving):
    fixed = SimpleNamespace(**vars(moving))
    fixed.base = BaseMotion(moving.base.quat_wxyz, np.zeros(3))
    solution = inverse.solve("bolted", fixed.q, fixed.dq, fixed.ddq, fixed.base)
    _, _, power, _ = Path(robot, fixed, np.zeros(3), np.zeros(3)).rates()
    motor_power = (solution.tau - friction_torque(fixed.dq)) @ fixed.dq
    assert motor_power == pytest.approx(power, rel=1e-5)
    assert not solution.lin_acc.any()
    assert not solution.ang_acc.any()


@pytest.mark.parametrize("support", ["hanging", "free"])
def test_a_floating_robot_gains_the_momentum_that_acts_on_it(robot, inverse, moving, support):
    solution = inverse.solve(support, moving.q, moving.dq, moving.ddq, moving.base)
    path = Path(robot, moving, solution.lin_acc, solution.ang_acc)
    push, twist, power, centre = path.rates()
    force = inverse.mass * GRAVITY if support == "hanging" else np.zeros(3)
    assert push == pytest.approx(force - inverse.mass * GRAVITY, abs=1e-3)
    point = torso_centre(robot, path.poses([0.0]))
    assert twist == pytest.approx(np.cross(point - centre, force), abs=1e-2)
    before, after = (torso_centre(robot, path.poses([t])) for t in (-STEP, STEP))
    lifted = force @ (after - before) / (2 * STEP)
    motor_power = (solution.tau - friction_torque(moving.dq)) @ moving.dq
    assert motor_power + lifted == pytest.approx(power, rel=1e-4, abs=1e-2)


def torso_centre(robot, poses):
    """The mass centre of the torso and what is fixed to it."""
    return merged_centres(robot, poses)[robot.link_index("torso_link")]


def merged_centres(robot, poses):
    """(L, 3) world: the mass centre of each moving link and what is fixed to it."""
    mass, moment = np.zeros((len(robot.link_names), 1)), np.zeros((len(robot.link_names), 3))
    for index, part, offset, _ in bodies_of(robot):
        above = index
        while robot.joint_of_link[above] < 0 and above > 0:
            above = robot.parent[above]
        turn = Rotation.from_quat(poses.quat_wxyz[0, index], scalar_first=True)
        mass[above] += part
        moment[above] += part * (poses.pos[0, index] + turn.apply(offset))
    return moment / np.maximum(mass, 1e-9)


def test_a_given_force_replaces_the_weight(inverse, moving):
    arguments = moving.q, moving.dq, moving.ddq, moving.base
    weight = inverse.solve("hanging", *arguments, force=inverse.mass * GRAVITY)
    assert weight.tau == pytest.approx(inverse.solve("hanging", *arguments).tau, abs=1e-9)
    nothing = inverse.solve("hanging", *arguments, force=np.zeros(3))
    assert nothing.tau == pytest.approx(inverse.solve("free", *arguments).tau, abs=1e-9)


def test_follow_takes_the_base_acceleration_as_given(inverse, moving):
    """A base that is led as it would move by itself is not held at all."""
    arguments = moving.q, moving.dq, moving.ddq
    free = inverse.solve("free", *arguments, moving.base)
    led = moving.base._replace(lin_acc=free.lin_acc, ang_acc=free.ang_acc)
    assert inverse.solve("follow", *arguments, led).tau == pytest.approx(free.tau, abs=1e-8)
    still = inverse.solve("follow", *arguments, moving.base)
    bolted = inverse.solve("bolted", *arguments, moving.base)
    assert still.tau.tolist() == bolted.tau.tolist()


def test_the_accelerometer_equals_a_simulated_one(robot, inverse):
    """And the base moves as the simulated one does, with the band's own force."""
    world = World(robot, "hanging")
    rng = np.random.default_rng(3)
    for _ in range(300):
        tau = rng.normal(0.0, 5.0, N_JOINTS)
        world.step(
            MotorCommand(
                np.ones(N_JOINTS, bool), *np.zeros((2, N_JOINTS)), tau, *np.zeros((2, N_JOINTS))
            )
        )
    state = world.state()
    base = BaseMotion(state.imu.quat_wxyz, state.imu.gyroscope)
    world._support.hold()
    mujoco.mj_forward(world.model, world.data)
    solution = inverse.solve(
        "hanging", state.q, state.dq, world.data.qacc[6:], base, force=world._support._force
    )
    assert np.linalg.norm(state.imu.gyroscope) > 0.1
    assert solution.lin_acc == pytest.approx(world.data.qacc[:3], abs=1e-8)
    assert solution.ang_acc == pytest.approx(world.data.qacc[3:6], abs=1e-8)
    measured = inverse.specific_force(solution, base)
    assert measured == pytest.approx(world.data.sensor("imu_acc").data, abs=1e-8)


def test_the_accelerometer_does_not_depend_on_the_last_solution(inverse, moving):
    on_its_side = BaseMotion(np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]), np.zeros(3))
    still = (moving.q, np.zeros(29), np.zeros(29))
    upright = inverse.solve("bolted", *still, UPRIGHT)
    lying = inverse.solve("bolted", *still, on_its_side)
    assert inverse.specific_force(upright, UPRIGHT) == pytest.approx(GRAVITY, abs=1e-9)
    assert inverse.specific_force(lying, on_its_side) == pytest.approx([0.0, 9.81, 0.0], abs=1e-9)


def test_in_free_fall_the_accelerometer_measures_zero_gravity(inverse, moving):
    at_rest = inverse.solve("free", moving.q, np.zeros(29), np.zeros(29), UPRIGHT)
    assert at_rest.tau == pytest.approx(np.zeros(29), abs=1e-9)
    assert at_rest.lin_acc == pytest.approx(-GRAVITY, abs=1e-9)


def test_friction_opposes_every_joint_once_it_moves():
    fast = friction_torque(np.full(29, 1.0))
    assert fast == pytest.approx(FRICTION + DAMPING, rel=1e-6)
    assert friction_torque(np.full(29, -1.0)).tolist() == (-fast).tolist()
    assert not friction_torque(np.zeros(29)).any()


KNEE, ANKLE = JOINT_NAMES.index("left_knee_joint"), JOINT_NAMES.index("left_ankle_pitch_joint")


@pytest.mark.slow
def test_a_simulation_with_the_same_support_follows_with_small_gains(robot, inverse, monkeypatch):
    """Without dry friction, whose sign at rest is unknown, and with a twentieth of the gains.

    That is less than it takes to balance the trunk on the waist, so the torques are those of the
    measured pose: what is left is for the model to get right, and not for the gains.
    """
    smooth = replace(NOMINAL, friction=np.zeros(N_JOINTS))
    monkeypatch.setattr(inverse, "_parameters", smooth)
    weight = inverse.mass * GRAVITY

    def pull(self):
        self._forces[self._torso, :3] = self._share * weight

    monkeypatch.setattr(Hanging, "hold", pull)
    trajectory = Trajectory(load_motion("demo"))
    world = World(robot, "hanging", joint_pos=trajectory.sample(0.0).joint_pos, timestep=2.5e-4)
    world.model.dof_frictionloss[:] = 0.0
    errors = []
    for _ in range(round(2.0 / world.timestep)):
        state, point = world.state(), trajectory.sample(world.data.time)
        base = BaseMotion(state.imu.quat_wxyz, state.imu.gyroscope)
        tau = inverse.solve("hanging", state.q, point.joint_vel, point.joint_acc, base).tau
        world.step(
            MotorCommand(
                np.ones(N_JOINTS, bool),
                point.joint_pos,
                point.joint_vel,
                tau,
                np.full(N_JOINTS, 2.0),
                np.full(N_JOINTS, 0.05),
            )
        )
        errors.append(trajectory.sample(world.data.time).joint_pos - world.state().q)
    assert np.abs(errors).max() < 1e-3
    assert np.ptp(trajectory.sample_many(np.linspace(0, 2, 50)).joint_pos, axis=0).max() > 0.3


def test_an_unknown_carrier_is_named(robot):
    with pytest.raises(RobotError, match="no link 'hook'"):
        InverseDynamics(robot, carrier="hook")


def test_a_urdf_without_masses_is_named(tmp_path, robot):
    root = ET.fromstring(robot.urdf)
    for link in root.iter("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    path = tmp_path / "weightless.urdf"
    path.write_text(ET.tostring(root, encoding="unicode"))
    with pytest.raises(RobotError, match="weightless"):
        InverseDynamics(G1.load(path))


def test_what_is_fixed_to_a_link_moves_its_centre_of_mass(robot):
    """By hand, from the URDF's masses: the head is part of the torso, the hands of the wrists."""
    poses = forward_kinematics(robot, np.zeros((1, N_JOINTS)), np.zeros(3), UPRIGHT.quat_wxyz)
    centres, found = merged_centres(robot, poses), centres_of_mass(robot)
    moving = (robot.joint_of_link >= 0) | (robot.parent < 0)
    assert not found[~moving].any()
    for link in np.flatnonzero(moving):
        turned = Rotation.from_quat(poses.quat_wxyz[0, link], scalar_first=True)
        expected = turned.inv().apply(centres[link] - poses.pos[0, link])
        np.testing.assert_allclose(found[link], expected, rtol=0, atol=1e-7)
