import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from g1stream.extras.physics.batch_dynamics import BatchInverseDynamics
from g1stream.extras.physics.example_motions import squatting
from g1stream.extras.physics.ground import FRICTION, zero_moment_point
from g1stream.extras.physics.measure import motion_physics, movement_loads
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_rotate
from g1stream.robot.soles import Soles
from g1stream.sim.model import build_model

G = 9.81
FPS = 30.0
UP = np.array([0.0, 0.0, 1.0])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
ROBOT = G1.default()
SOLES = Soles(ROBOT)
LENGTH = 0.174  # of a sole, between the lowest points of its spheres, m
YES = dict.fromkeys(("bolted", "hanging", "follow", "free"), "yes")


def joints(**angles):
    q = np.zeros(N_JOINTS)
    for name, angle in angles.items():
        q[JOINT_NAMES.index(f"{name}_joint")] = angle
    return q


def masses():
    """Link, mass and mass centre in its frame of every link, from the URDF."""
    for link in ET.fromstring(ROBOT.urdf).iter("link"):
        if (inertial := link.find("inertial")) is not None:
            centre = [float(x) for x in inertial.find("origin").attrib["xyz"].split()]
            yield link.attrib["name"], float(inertial.find("mass").attrib["value"]), centre


def mass_centre(q, root_pos):
    """The centre (T, 3) of the mass, world, by the URDF's figures and the kinematics."""
    poses = poses_of(q, root_pos)
    total, moment = 0.0, np.zeros(3)
    for link, mass, centre in masses():
        i = ROBOT.link_index(link)
        turned = quat_rotate(poses.quat_wxyz[:, i], np.array(centre))
        total, moment = total + mass, moment + mass * (poses.pos[:, i] + turned)
    return moment / total


def poses_of(q, root_pos):
    return forward_kinematics(ROBOT, np.atleast_2d(q), root_pos, UPRIGHT)


def stances(knees, forward=0.0):
    """Poses (T, 29) and root positions (T, 3): flat soles on the floor, around the origin.

    Args:
        knees: (T,) rad.
        forward: by which the mass centre is in front of the middle of the soles, m.
    """
    knees = np.asarray(knees)
    q = np.tile(joints(left_shoulder_roll=0.2, right_shoulder_roll=-0.2), (len(knees), 1))
    low, high = np.full((2, len(knees)), [[-1.5], [0.5]])
    for _ in range(40):
        hips = (low + high) / 2
        for part, angles in (("hip_pitch", hips), ("knee", knees), ("ankle_pitch", -hips - knees)):
            for side in ("left", "right"):
                q[:, JOINT_NAMES.index(f"{side}_{part}_joint")] = angles
        corners = SOLES.positions(poses_of(q, np.zeros(3)))
        middle = corners.mean(axis=1)
        # Hips that are bent further bring the feet forward.
        behind = mass_centre(q, np.zeros(3))[:, 0] - middle[:, 0] < forward
        low, high = np.where(behind, hips, low), np.where(behind, high, hips)
    return q, -np.column_stack([middle[:, :2], corners[..., 2].min(axis=1)])


def stance(knee, forward=0.0):
    (q,), (root_pos,) = stances([knee], forward)
    return q, root_pos


def still(q, root_pos, frames=20):
    return moving(np.tile(q, (frames, 1)), np.tile(root_pos, (frames, 1)))


def moving(q, root_pos, quat=UPRIGHT):
    quat = np.broadcast_to(quat, (len(q), 4))
    return Motion(name="made", fps=FPS, joint_pos=q, root_pos=root_pos, root_quat_wxyz=quat)


def of(physics, support):
    """Cause -> excess of a support."""
    return {excess.cause: excess for excess in physics.verdicts[support].excesses}


def answers(physics):
    return {support: physics.verdicts[support].playable for support in YES}


@pytest.fixture(scope="module")
def squat():
    """Down and up again: knees from 0.5 to 1 rad in a second, soles flat, mass centre above."""
    phase = np.concatenate([np.zeros(5), np.linspace(0, 2 * np.pi, 61), np.zeros(5)])
    return moving(*stances(0.75 - 0.25 * np.cos(phase)))


def test_a_squat_can_be_played_with_every_support(squat):
    physics = motion_physics(squat)
    assert answers(physics) == YES
    assert physics.supported_share == physics.inside_share == 1.0
    assert [foot.contact_share for foot in physics.feet] == [1.0, 1.0]
    assert max(foot.skating_max_mm_s for foot in physics.feet) < 2.0
    assert max(foot.penetration_mm for foot in physics.feet) < 1.0
    assert physics.collisions == ()
    assert not any(peak.frames for peaks in physics.torques.values() for peak in peaks)
    assert physics.mass_kg == pytest.approx(sum(mass for _, mass, _ in masses()), rel=1e-6)
    poses, still = poses_of(squat.joint_pos, squat.root_pos), np.zeros_like(squat.joint_pos)
    _, tilt = BatchInverseDynamics.of(ROBOT).batch(poses, still, still).hanging()
    assert physics.hanging_tilt_rad == pytest.approx(tilt.max())


def loads_of(motion):
    nothing = np.zeros((motion.n_frames, 8, 3)), np.zeros((motion.n_frames, 8), bool)
    return movement_loads(Trajectory(motion), ROBOT, SOLES, *nothing, lambda part, poses: None)


def centre_of_pressure(motion):
    """(T, 2) m."""
    loads = loads_of(motion)
    return zero_moment_point(loads.force, loads.moment)


def test_frames_of_a_part_keep_their_numbers(squat):
    part = motion_physics(squat, frames=range(20, 30))
    assert (part.first_frame, part.frames) == (20, 10)
    tau = loads_of(squat).tau["bolted"][20:30]
    for peak in part.torques["bolted"]:
        of_joint = tau[:, JOINT_NAMES.index(peak.joint)]
        assert peak.torque_nm == pytest.approx(of_joint[np.abs(of_joint).argmax()], abs=1e-9)
        assert peak.time_s == peak.frame / FPS
        assert abs(of_joint[peak.frame - 20]) == pytest.approx(abs(peak.torque_nm))
    assert 20 <= part.margin_frame < 30
    left, right = motion_physics(squat, frames=range(20, 71)).feet
    assert left.penetration_frame >= 20
    assert right.skating_max_frame >= 20


@pytest.mark.parametrize("forward", [0.05, -0.06, 0.12])
def test_at_rest_the_centre_of_pressure_is_below_the_mass_centre(forward):
    motion = still(*stance(0.6, forward))
    centre = mass_centre(motion.joint_pos, motion.root_pos)
    assert centre[:, 0] == pytest.approx(np.full(20, forward), abs=1e-6)
    assert centre_of_pressure(motion) == pytest.approx(centre[:, :2], abs=1e-6)
    physics = motion_physics(motion)
    margin = LENGTH / 2 - abs(forward)
    assert physics.margin_mm == pytest.approx(1e3 * margin, abs=2.0)
    pressure = of(physics, "free").get("centre of pressure")
    if margin > 0:
        assert pressure is None
        assert answers(physics)["free"] == "yes"
    else:
        assert pressure.worst == pytest.approx(-1e3 * margin, abs=2.0)
        assert pressure.spans == ((0, 19),)
        assert answers(physics) == dict(YES, free="no")


def test_friction_is_sideways_over_weight():
    q, root_pos = stance(0.6)
    times, acceleration = np.arange(31) / FPS, 7.0
    ahead = acceleration * (times - times[15]) ** 2 / 2
    physics = motion_physics(moving(np.tile(q, (31, 1)), root_pos + np.outer(ahead, [0, 1, 0])))
    friction = of(physics, "free")["friction"]
    assert friction.worst == pytest.approx(acceleration / G, rel=0.02)
    assert friction.limit == FRICTION
    assert friction.spans[0][0] <= 15 <= friction.spans[-1][1]


@pytest.mark.parametrize(("speed", "told"), [(0.08, False), (0.12, True)])
def test_feet_that_slide(speed, told):
    q, root_pos = stance(0.6)
    path = np.outer(speed * np.arange(20) / FPS, [0.6, 0.8, 0.0])
    physics = motion_physics(moving(np.tile(q, (20, 1)), root_pos + path))
    for foot in physics.feet:
        assert foot.skating_mm_s == pytest.approx(1e3 * speed)
        assert foot.skating_max_mm_s == pytest.approx(1e3 * speed)
    assert ("skating" in of(physics, "free")) is told
    assert answers(physics)["free"] == ("inexact" if told else "yes")


def test_feet_that_slide_too_fast_to_stand_are_no_lack_of_support():
    """Both soles 5 mm above the floor, at 0.8 m/s: they carry the weight and hold nothing."""
    q, root_pos = stance(0.6)
    path = np.outer(0.8 * np.arange(20) / FPS, [0.6, 0.8, 0.0]) + 0.005 * UP
    physics = motion_physics(moving(np.tile(q, (20, 1)), root_pos + path))
    found = of(physics, "free")
    assert "support" not in found
    skating = found["skating"]
    assert (skating.worst, skating.forbids) == (pytest.approx(800.0), True)
    assert answers(physics)["free"] == "no"
    higher = motion_physics(moving(np.tile(q, (20, 1)), root_pos + path + 0.1 * UP))
    assert "skating" not in of(higher, "free")
    assert of(higher, "free")["support"].worst == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(("rise", "forbids"), [(0.01, True), (0.001, False)])
def test_a_short_force_that_nothing_exerts_forbids_a_motion_if_it_is_large(rise, forbids):
    """In flight the pelvis is moved up by `rise` within a frame of 10 ms."""
    q, root_pos = stance(0.6)
    times = np.arange(20) / 100.0
    path = root_pos + np.outer(1.0 + 2.8 * times - G * times**2 / 2, [0, 0, 1])
    path[10:] += rise * UP
    motion = replace(moving(np.tile(q, (20, 1)), path), fps=100.0)
    support = of(motion_physics(motion), "free")["support"]
    assert support.longest_s < 0.1
    assert support.forbids is forbids


def test_feet_below_the_floor_and_above_it():
    q, root_pos = stance(0.6)
    for height in (-15.0, 8.0):
        physics = motion_physics(still(q, root_pos + 1e-3 * height * UP))
        for foot in physics.feet:
            assert foot.height_mm == pytest.approx(height, abs=1.0)
            assert foot.penetration_mm == pytest.approx(max(0.0, -height), abs=1.0)
        assert ("penetration" in of(physics, "free")) is (height < 0)


def test_hovering_needs_support_and_falling_does_not():
    q, root_pos = stance(0.6)
    hovering = motion_physics(still(q, root_pos + 0.3 * UP))
    support = of(hovering, "free")["support"]
    assert (support.worst, support.forbids) == (pytest.approx(1.0, rel=1e-6), True)
    assert hovering.supported_share == 0.0
    assert hovering.margin_mm is None
    times = np.arange(20) / FPS
    path = root_pos + np.outer(0.2 + 2.8 * times - G * times**2 / 2, [0, 0, 1])
    flying = motion_physics(moving(np.tile(q, (20, 1)), path))
    assert flying.supported_share == 0.0
    # The natural spline has no acceleration at its ends: there, and next to them, it is no fall.
    assert all(last - first < 3 for first, last in of(flying, "free")["support"].spans)
    assert answers(flying)["free"] == "inexact"


def test_tilt_ends_a_run_where_the_pelvis_follows():
    """It leans by 0.05 rad a frame: more than 1 rad from frame 21 on."""
    q, root_pos = stance(0.6)
    angles = 0.05 * np.arange(40)
    quat = np.stack([np.cos(angles / 2), 0 * angles, np.sin(angles / 2), 0 * angles], axis=1)
    motion = moving(np.tile(q, (40, 1)), np.tile(root_pos + UP, (40, 1)), quat)
    physics = motion_physics(motion)
    tilt = of(physics, "free")["tilt"]
    assert (tilt.limit, tilt.spans, tilt.forbids) == (1.0, ((21, 39),), True)
    assert physics.tilt_rad == pytest.approx(1.95)
    assert answers(physics)["bolted"] == answers(physics)["hanging"] == "yes"
    assert "tilt" not in of(physics, "follow")  # it is held
    assert "tilt" not in of(motion_physics(motion, max_tilt=2.0), "free")
    assert of(motion_physics(motion, max_tilt=1.0), "follow")["tilt"] == tilt


def test_more_torque_than_a_motor_has():
    """A shoulder that swings by 0.4 rad at 4 Hz: 250 rad/s^2 at most."""
    times = np.arange(40) / FPS
    q = np.tile(joints(left_shoulder_roll=0.6), (40, 1))
    q[:, JOINT_NAMES.index("left_shoulder_pitch_joint")] = 0.4 * np.sin(2 * np.pi * 4 * times)
    physics = motion_physics(moving(q, np.tile([0.0, 0.0, 1.0], (40, 1))))
    torque = of(physics, "bolted")["torque"]
    assert (torque.where, torque.limit) == ("left_shoulder_pitch_joint", 25.0)
    assert torque.worst > 25.0
    assert not torque.forbids
    assert answers(physics)["bolted"] == "inexact"


def test_standing_takes_the_torques_that_servos_reach_in_mujoco():
    """Still, on four spheres a foot, with stiff servos; what is left is dry friction."""
    q, root_pos = stance(0.9)
    model = build_model(
        ROBOT, floating=True, driven=False, timestep=0.002, self_collision=False, visual=False
    )
    data = mujoco.MjData(model)
    order = [model.joint(name).qposadr[0] for name in JOINT_NAMES]
    data.qpos[:7] = *root_pos, *UPRIGHT
    data.qpos[order] = q
    stiffness, damping = 1500.0, 20.0
    model.actuator_gainprm[:, 0] = 1.0
    model.actuator_biasprm[:, 1:3] = -stiffness, -damping
    data.ctrl[:] = stiffness * q
    for _ in range(1500):
        mujoco.mj_step(model, data)
    assert abs(data.qpos[2] - root_pos[2]) < 0.02
    peaks = motion_physics(still(data.qpos[order], data.qpos[:3])).torques["free"]
    expected = np.array(data.actuator_force)
    found = {peak.joint: peak.torque_nm for peak in peaks}
    for name in ("hip_pitch", "knee", "ankle_pitch"):
        for side in ("left", "right"):
            joint = f"{side}_{name}_joint"
            assert found[joint] == pytest.approx(expected[JOINT_NAMES.index(joint)], abs=1.0)
    assert abs(found["left_knee_joint"]) > 10.0


@pytest.mark.slow
def test_an_arm_inside_the_torso():
    """Ten frames of it: which links, how deep, when."""
    q, root_pos = stance(0.6)
    path = np.tile(q, (30, 1))
    roll = JOINT_NAMES.index("left_shoulder_roll_joint")
    path[10:20, roll] = -0.3
    motion = moving(path, np.tile(root_pos, (30, 1)))
    physics = motion_physics(motion)
    deepest = physics.collisions[0]
    assert {deepest.link, deepest.other} == {"torso_link", "left_shoulder_yaw_link"}
    assert deepest.simulated
    assert deepest.spans == ((10, 19),)
    assert 10.0 < deepest.depth_mm < 100.0
    assert deepest.depth_mm == max(one.depth_mm for one in physics.collisions)
    for support in ("bolted", "hanging", "follow", "free"):
        excess = of(physics, support)["self-collision"]
        assert (excess.worst, excess.forbids) == (deepest.depth_mm, False)
        assert excess.spans == ((10, 19),)
    assert {answers(physics)[support] for support in ("bolted", "hanging")} == {"inexact"}
    part = motion_physics(motion, frames=range(15, 30))
    assert part.collisions[0].spans == ((15, 19),)
    assert part.collisions[0].depth_mm == pytest.approx(deepest.depth_mm)
    assert of(part, "bolted")["self-collision"].spans == ((15, 19),)
    assert motion_physics(motion, frames=range(20, 30)).collisions == ()


def test_knees_on_the_floor_are_told():
    q = joints(left_knee=2.0, right_knee=2.0)
    knees = [ROBOT.link_index(f"{side}_knee_link") for side in ("left", "right")]
    height = poses_of(q, np.zeros(3)).pos[0, knees, 2].min()
    physics = motion_physics(still(q, np.array([0.0, 0.0, -height])))
    contact = of(physics, "free")["floor contact"]
    assert "knee" in contact.where
    assert 30.0 < contact.worst < 90.0  # the radius of a knee
    assert contact.forbids


def test_a_motion_is_played_on_the_feet_with_small_changes():
    found = motion_physics(squatting(1.0)).verdicts["feet"]
    assert found.playable == "yes"
    assert "feet moved by up to 1 mm" in found.changed
    assert motion_physics(squatting(1.0), G1.load("g1_23dof")).verdicts["feet"].playable == "no"


def test_the_part_that_can_be_played_on_the_feet_is_looked_for_if_asked():
    squat = squatting(3.0)
    root_pos = squat.root_pos.copy()
    root_pos[100:, 0] += np.linspace(0.0, 1.0, len(root_pos) - 100)
    sliding = moving(squat.joint_pos, root_pos)
    assert motion_physics(sliding).verdicts["feet"].instead == ""
    found = motion_physics(sliding, suggest=True).verdicts["feet"]
    assert found.playable == "no"
    assert "left foot slides in frames " in found.refused
    start, duration = re.search(r"--start (\S+) --duration (\S+),", found.instead).groups()
    assert float(start) == 0.0
    assert float(duration) == pytest.approx(100 / sliding.fps, abs=0.4)
    assert found.instead in str(found)
    assert motion_physics(sliding, frames=range(90)).verdicts["feet"].playable == "yes"
    arms = motion_physics(sliding, played=ROBOT.select("arms"), suggest=True).verdicts["feet"]
    assert (arms.playable, arms.instead) == ("yes", "")
    leg = motion_physics(sliding, played=ROBOT.select("left_leg")).verdicts["feet"]
    assert leg.playable == "no"
