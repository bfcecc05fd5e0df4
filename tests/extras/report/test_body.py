"""Figures of papers, recomputed from the definitions in the code that prints them."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.analysis.body import Frames, RobotFrames, body_metrics
from g1stream.robot.model import G1
from known_arrays import Oracle

#: `body_names` of the G1's tracking tasks in whole_body_tracking and mjlab 1.6.0.
BODIES = [
    "pelvis",
    "left_hip_roll_link",
    "left_knee_link",
    "left_ankle_roll_link",
    "right_hip_roll_link",
    "right_knee_link",
    "right_ankle_roll_link",
    "torso_link",
    "left_shoulder_roll_link",
    "left_elbow_link",
    "left_wrist_yaw_link",
    "right_shoulder_roll_link",
    "right_elbow_link",
    "right_wrist_yaw_link",
]
ENDS = [BODIES.index(name) for name in BODIES if "ankle" in name or "wrist" in name]
TORSO = BODIES.index("torso_link")
N = 7


def some_robot(seed):
    """Frames of a robot that leans, turns and walks."""
    random = np.random.default_rng(seed)
    turn = Rotation.from_euler("zyx", random.normal(size=(N, 3)) * [1.0, 0.3, 0.3])
    return RobotFrames(
        q=0.3 * random.normal(size=(N, 29)),
        dq=random.normal(size=(N, 29)),
        root_pos=random.normal(size=(N, 3)) * [1.0, 1.0, 0.05] + [0.0, 0.0, 0.75],
        root_lin_vel=np.zeros((N, 3)),
        root_quat_wxyz=turn.as_quat(scalar_first=True),
        root_ang_vel=np.zeros((N, 3)),
    )


def sampled(reference, measured, *, has_position=True):
    times, following = np.arange(N) / 50, np.ones(N - 1, bool)
    return Frames(times, following, reference, measured, True, has_position)


def bodies_of(state):
    """Positions (N, 14, 3) and rotation matrices (N, 14, 3, 3) of the bodies by MuJoCo."""
    oracle, pos, rotations = Oracle(G1.default()), [], []
    for frame in range(N):
        row = {name: values[frame] for name, values in state._asdict().items()}
        point = SimpleNamespace(joint_pos=row.pop("q"), joint_vel=row.pop("dq"), **row)
        found = oracle.bodies(point)
        pos.append([found[name].pos for name in BODIES])
        quats = [found[name].quat for name in BODIES]
        rotations.append(Rotation.from_quat(quats, scalar_first=True).as_matrix())
    return np.array(pos), np.array(rotations)


def reattached(reference, robot):
    """mjlab's `body_pos_relative_w` and `body_quat_relative_w`, as a position and a matrix.

    The place is the robot's torso with the height of the reference's; the turn is the yaw of the
    rotation from the reference's torso to the robot's.
    """
    (pos, rotation), (robot_pos, robot_rotation) = reference, robot
    place = np.append(robot_pos[TORSO, :2], pos[TORSO, 2])
    delta = robot_rotation[TORSO] @ rotation[TORSO].T
    yaw = np.arctan2(delta[1, 0], delta[0, 0])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    return np.array([place + turn @ (one - pos[TORSO]) for one in pos]), turn @ rotation


def test_the_figures_of_mjlab_and_the_terminations_of_beyondmimic():
    states = some_robot(1), some_robot(2)
    (pos, rotation), (robot_pos, robot_rotation) = (bodies_of(one) for one in states)
    mpkpe, r_mpkpe, ee_pos, ee_ori = [], [], [], []
    for frame in range(N):
        reference = pos[frame], rotation[frame]
        robot = robot_pos[frame], robot_rotation[frame]
        moved, turned = reattached(reference, robot)
        mpkpe.append(np.linalg.norm(pos[frame] - robot[0], axis=1).mean())
        distance = np.linalg.norm(moved - robot[0], axis=1)
        r_mpkpe.append(distance.mean())
        ee_pos.append(distance[ENDS].mean())
        traces = [np.trace(turned[i].T @ robot[1][i]) for i in ENDS]
        ee_ori.append(np.arccos((np.array(traces) - 1) / 2).mean())
    speeds = np.sqrt(((states[0].dq - states[1].dq) ** 2).mean(axis=1))
    found = body_metrics(G1.default(), sampled(*states))
    near = {"rel": 1e-6}
    assert found.mjlab.mpkpe_mm == pytest.approx(1e3 * np.mean(mpkpe), **near)
    assert found.mjlab.r_mpkpe_mm == pytest.approx(1e3 * np.mean(r_mpkpe), **near)
    assert found.mjlab.ee_pos_error_mm == pytest.approx(1e3 * np.mean(ee_pos), **near)
    assert found.mjlab.ee_ori_error_rad == pytest.approx(np.mean(ee_ori), **near)
    assert found.mjlab.joint_vel_error_rad_s == pytest.approx(speeds.mean(), **near)
    ends = found.terminations
    heights = np.abs(pos - robot_pos)[..., 2]
    assert ends.max_anchor_height_mm == pytest.approx(1e3 * heights[:, TORSO].max(), **near)
    assert ends.max_end_effector_height_mm == pytest.approx(1e3 * heights[:, ENDS].max(), **near)
    gravity = np.abs(rotation[:, TORSO, 2, 2] - robot_rotation[:, TORSO, 2, 2])
    assert ends.max_gravity_difference == pytest.approx(gravity.max(), **near)


def test_place_and_heading_are_no_error_for_mjlab_and_the_height_is():
    reference = some_robot(3)
    turn = Rotation.from_euler("z", 2.0)
    quat = turn * Rotation.from_quat(reference.root_quat_wxyz, scalar_first=True)
    elsewhere = reference._replace(
        root_pos=turn.apply(reference.root_pos) + np.array([3.0, -1.0, 0.1]),
        root_quat_wxyz=quat.as_quat(scalar_first=True),
    )
    found = body_metrics(G1.default(), sampled(reference, elsewhere))
    assert found.mjlab.r_mpkpe_mm == pytest.approx(100.0)
    assert found.mjlab.ee_pos_error_mm == pytest.approx(100.0)
    assert found.mjlab.ee_ori_error_rad == pytest.approx(0.0, abs=1e-7)
    assert found.mjlab.mpkpe_mm > 2000.0
    assert found.terminations.max_anchor_height_mm == pytest.approx(100.0)


def test_a_bent_waist_is_an_error_of_the_anchor():
    """The pelvis stays upright, and the torso leans."""
    reference = some_robot(4)._replace(q=np.zeros((N, 29)))
    bent = np.zeros((N, 29))
    bent[:, 14] = 0.5  # waist pitch
    found = body_metrics(G1.default(), sampled(reference, reference._replace(q=bent)))
    assert found.terminations.max_gravity_difference > 0.1
    assert found.pelvis.max_orientation_rad == pytest.approx(0.0, abs=1e-7)


def test_without_a_torso_link_the_pelvis_is_the_anchor():
    robot = G1.from_urdf(G1.default().urdf.replace('"torso_link"', '"chest"'), "chest.urdf")
    states = some_robot(9), some_robot(10)
    found = body_metrics(robot, sampled(*states)).terminations
    higher = np.abs(states[0].root_pos - states[1].root_pos)[:, 2]
    assert found.max_anchor_height_mm == pytest.approx(1e3 * higher.max())
    upright = [
        Rotation.from_quat(one.root_quat_wxyz, scalar_first=True).as_matrix()[:, 2, 2]
        for one in states
    ]
    assert found.max_gravity_difference == pytest.approx(np.abs(upright[0] - upright[1]).max())


@pytest.mark.parametrize(
    ("robot", "joints", "has_position", "there"),
    [
        ("g1_29dof", range(29), True, True),
        ("g1_29dof", range(29), False, False),
        ("g1_29dof", range(15, 29), True, False),
        ("g1_23dof", np.flatnonzero(G1.load("g1_23dof").present), True, True),
    ],
)
def test_when_mjlabs_figures_are_known(robot, joints, has_position, there):
    frames = sampled(some_robot(5), some_robot(6), has_position=has_position)
    found = body_metrics(G1.load(robot), frames, joints)
    assert (found.mjlab is not None) is there
    assert (found.terminations is not None) is has_position


def test_a_robot_without_velocities_has_no_error_of_them():
    measured = some_robot(7)._replace(dq=np.zeros((N, 29)))
    found = body_metrics(G1.default(), sampled(some_robot(8), measured))
    assert found.mjlab.joint_vel_error_rad_s is None
