from dataclasses import replace
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from g1stream.errors import SimError
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.model import G1
from g1stream.sim.world import MotorCommand, Root, World


def test_torque_limits_are_those_of_unitree_mujoco(robot, servo):
    leg, arm = [88, 88, 88, 139, 50, 50], [25, 25, 25, 25, 25, 5, 5]
    world = World(robot)
    world.step(servo(tau=1000.0, kp=0.0, kd=0.0))
    felt = world.data.qfrc_actuator[dofs(world)]
    assert felt.tolist() == [*leg, *leg, 88, 50, 50, *arm, *arm]
    assert world.state().tau_est.tolist() == felt.tolist()


def test_joint_mechanics_are_those_of_unitree_mujoco(robot):
    world = World(robot)
    joints = dofs(world)
    assert (world.model.dof_armature[joints] == 0.01).all()
    assert (world.model.dof_damping[joints] == 0.05).all()
    arm = [0.2] * 5 + [0.1] * 2
    assert world.model.dof_frictionloss[joints].tolist() == [*[0.2] * 15, *arm, *arm]


def test_motor_order_is_joint_order(robot, servo):
    world = World(robot)
    rest = Root(np.zeros(3), np.array([1.0, 0, 0, 0]), *np.zeros((2, 3)), playing=False)

    def acceleration(command):
        world.set_state(np.zeros(N_JOINTS), np.zeros(N_JOINTS), rest)
        world.step(command)
        return world.state().ddq

    at_rest = acceleration(MotorCommand.off())
    for motor, dof in enumerate(dofs(world)):
        alone = np.arange(N_JOINTS) == motor
        found = acceleration(servo(tau=4.0 * alone, kp=0.0, kd=0.0))[motor]
        assert found - at_rest[motor] > 5
        assert world.data.qvel[dof] == pytest.approx(found * world.timestep)


def dofs(world):
    """The degree of freedom of each motor's joint."""
    return [world.model.joint(name).dofadr[0] for name in JOINT_NAMES]


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
    places = [world.model.joint(name).qposadr[0] for name in JOINT_NAMES]
    for name in JOINT_NAMES:
        child = world.model.joint(name).bodyid[0]
        parent = world.model.body_weldid[world.model.body_parentid[child]]
        adjacent.add((world.model.body(parent).name, world.model.body(child).name))
    for _ in range(100):
        world.data.qpos[places] = rng.uniform(robot.lower, robot.upper)
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


def test_urdf_with_meshes_and_fingers(reference_urdf, servo, run):
    world = World(G1.load(reference_urdf("g1_29dof_with_hand_rev_1_0.urdf")), "hanging")
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
    world = World(altered(robot, "imu_in_", "frame_in_"))
    assert world.state().imu.accelerometer == pytest.approx([0, 0, 9.81])
    model = world.model
    assert model.body(model.site("secondary_imu").bodyid[0]).name == "torso_link"


def test_link_without_mass_is_refused(robot):
    with pytest.raises(SimError, match=r"mine\.urdf"):
        World(altered(robot, '<mass value="1.932"', '<mass value="0"'))


@pytest.mark.parametrize("support", ["bolted", "hanging"])
def test_shapes_for_a_viewer_do_not_change_the_physics(robot, support, servo):
    bare, shown = World(robot, support), World(robot, support, visual=True)
    assert (bare.model.geom_contype | bare.model.geom_conaffinity).all()
    assert shown.model.ngeom > bare.model.ngeom
    for _ in range(100):
        for world in (bare, shown):
            world.step(servo(q=0.3), 2)
    assert bare.data.qpos.tobytes() == shown.data.qpos.tobytes()
    assert bare.data.ncon == shown.data.ncon > 0
