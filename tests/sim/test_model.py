"""The compiled model: figures, order, contacts, and URDFs of other makes."""

from __future__ import annotations

import sysconfig
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from g1stream.errors import SimError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.sim.world import MotorCommand, World

UNITREE_URDFS = Path(
    sysconfig.get_path("purelib"),
    "cmeel.prefix/share/example-robot-data/robots/g1_description/urdf",
)
GRAVITY = 9.81


def test_torque_limits_are_those_of_unitree_mujoco(robot, servo):
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


def test_joint_mechanics_are_those_of_unitree_mujoco(robot):
    model = World(robot).model
    for name in JOINT_NAMES:
        dof = model.joint(name).dofadr[0]
        assert model.dof_armature[dof] == 0.01, name
        assert model.dof_damping[dof] == 0.05, name
        small = "wrist_pitch" in name or "wrist_yaw" in name
        assert model.dof_frictionloss[dof] == (0.1 if small else 0.2), name


@pytest.mark.parametrize("motor", range(N_JOINTS))
def test_motor_order_is_joint_order(robot, motor, servo):
    world = World(robot)
    world.step(MotorCommand.off())
    at_rest = world.state().ddq
    world = World(robot)
    world.step(servo(tau=4.0 * (np.arange(N_JOINTS) == motor), kp=0.0, kd=0.0))
    pushed = world.state().ddq - at_rest
    joint = world.model.joint(JOINT_NAMES[motor])
    assert pushed[motor] > 5
    speed = (pushed[motor] + at_rest[motor]) * world.data.time  # from rest
    assert world.data.qvel[joint.dofadr[0]] == pytest.approx(speed)


def test_links_may_come_in_any_order(robot, servo, run):
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


def links_in_contact(world):
    """The moving links of each contact; what is fixed to a link counts as that link."""
    model = world.model
    moving = model.body_weldid[model.geom_bodyid[world.data.contact.geom]]
    return {tuple(model.body(link).name for link in sorted(pair)) for pair in moving}


def test_feet_meet_the_floor(robot):
    low = World(robot, base_height=0.78)
    feet = {f"{side}_ankle_roll_link" for side in ("left", "right")}
    assert links_in_contact(low) == {("world", foot) for foot in feet}
    assert World(robot).data.ncon == 0


@pytest.mark.parametrize("support", ["bolted", "hanging"])
def test_links_with_one_joint_between_never_collide(robot, rng, support):
    adjacent, seen = set(), set()
    world = World(robot, support)
    for name in JOINT_NAMES:
        child = world.model.joint(name).bodyid[0]
        parent = world.model.body_weldid[world.model.body_parentid[child]]
        adjacent.add((world.model.body(parent).name, world.model.body(child).name))
    for _ in range(100):
        pose = rng.uniform(robot.lower, robot.upper)
        world.data.qpos[[world.model.joint(name).qposadr[0] for name in JOINT_NAMES]] = pose
        mujoco.mj_forward(world.model, world.data)
        seen |= links_in_contact(world)
    assert len(seen) > 20
    assert not seen & adjacent


@pytest.mark.parametrize("self_collision", [True, False])
def test_arms_pressed_together(robot, servo, run, self_collision):
    """Both forearms are commanded through each other, in front of the chest."""
    pose = np.zeros(N_JOINTS)
    for side, inward in (("left", -1.0), ("right", 1.0)):
        for joint, angle in (("shoulder_pitch", -0.6), ("shoulder_yaw", 0.9 * inward)):
            pose[JOINT_NAMES.index(f"{side}_{joint}_joint")] = angle
    world = World(robot, self_collision=self_collision)
    left, right = (world.data.body(f"{side}_wrist_yaw_link").xpos for side in ("left", "right"))
    assert left[1] - right[1] > 0.2
    depths = []
    for way in (*np.linspace(0, 1, 20), *np.ones(10)):
        run(world, servo(q=way * pose), 0.05)
        depths.append(-min(world.data.contact.dist, default=0.0))
    if self_collision:
        assert ("left_wrist_yaw_link", "right_wrist_yaw_link") in links_in_contact(world)
        assert left[1] - right[1] > 0.05
        assert 0.0 < max(depths) < 0.005
    else:
        assert left[1] - right[1] < -0.02
        assert max(depths) == 0.0


def test_feet_stop_at_the_floor(robot, servo, run):
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


def feet(world):
    """The shapes of the feet that meet the floor."""
    return [
        geom
        for geom in range(world.model.ngeom)
        if world.model.geom_conaffinity[geom]
        and "ankle_roll" in world.model.body(world.model.geom_bodyid[geom]).name
    ]


@pytest.mark.parametrize("name", ["g1_29dof_rev_1_0", "g1_29dof_with_hand_rev_1_0"])
def test_urdf_with_meshes_and_fingers(name, servo, run):
    urdf = UNITREE_URDFS / f"{name}.urdf"
    if not urdf.exists():
        pytest.skip(f"{name} is in example-robot-data, of the extra `meshes`")
    world = World(G1.load(urdf), "hanging")
    assert world.model.nv == 6 + N_JOINTS
    assert {
        world.model.mesh(mesh).name.rpartition("_hull_")[1] for mesh in range(world.model.nmesh)
    } == {"_hull_"}
    run(world, servo(), 0.1)
    assert np.isfinite(world.state().q).all()


def altered(robot, old, new):
    assert old in robot.urdf
    return replace(robot, source="mine.urdf", urdf=robot.urdf.replace(old, new))


def test_without_imu_frames_they_sit_in_pelvis_and_torso(robot):
    renamed = altered(robot, "imu_in_", "frame_in_")
    state = World(renamed).state()
    assert state.imu.accelerometer == pytest.approx([0, 0, GRAVITY])
    model = World(renamed).model
    assert model.body(model.site("secondary_imu").bodyid[0]).name == "torso_link"


def test_link_without_mass_is_refused(robot):
    with pytest.raises(SimError, match=r"mine\.urdf"):
        World(altered(robot, '<mass value="1.932"', '<mass value="0"'))
