import numpy as np
import pytest
from scipy.optimize import nnls

from g1stream.errors import RobotError
from g1stream.extras.physics.ground import (
    FRICTION,
    beyond_support,
    floor_forces,
    touching,
    zero_moment_point,
)
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.soles import Soles

RNG = np.random.default_rng(3)
SQUARE = np.array([(1, 1, 0), (1, -1, 0), (-1, -1, 0), (-1, 1, 0)], dtype=float)


def test_corners_are_the_spheres_of_unitrees_model(robot):
    """They have a radius of 5 mm and are at x -0.05 and 0.12, y 0.025 and 0.03, z -0.03."""
    soles, upright = Soles(robot), np.array([1.0, 0.0, 0.0, 0.0])
    poses = forward_kinematics(robot, np.zeros((1, N_JOINTS)), np.zeros(3), upright)
    corners = soles.positions(poses).reshape(2, 4, 3) - poses.pos[0, soles.links, np.newaxis]
    spheres = [(0.12, 0.03, -0.03), (0.12, -0.03, -0.03), (-0.05, -0.025, -0.03)]
    spheres.append((-0.05, 0.025, -0.03))
    distance = np.linalg.norm(corners - spheres, axis=-1)
    assert distance == pytest.approx(np.full((2, 4), 0.005), abs=2e-4)
    assert corners[..., 2] == pytest.approx(np.full((2, 4), -0.035), abs=1e-3)


def test_a_robot_with_other_feet_or_none_is_refused(robot):
    other = G1.from_urdf(robot.urdf.replace("ankle_roll_link", "foot"), "other.urdf")
    with pytest.raises(RobotError, match="left_foot"):
        Soles(other)
    with pytest.raises(RobotError, match="g1_dual_arm"):
        Soles(G1.load("g1_dual_arm"))


def test_distance_from_any_polygon():
    """Against the support function in 20,000 directions."""
    points, corners = 0.7 * RNG.normal(size=(50, 2)), RNG.normal(size=(50, 8, 3))
    touches = RNG.random((50, 8)) < 0.5
    touches[:, 0] = True
    angles = np.linspace(0, 2 * np.pi, 20_000)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    found = beyond_support(points, corners, touches)
    for point, own, on, distance in zip(points, corners, touches, found, strict=True):
        reach = (own[on, :2] @ directions.T).max(axis=0)
        assert distance == pytest.approx((directions @ point - reach).max(), abs=2e-3)
    assert (found < 0).sum() > 5
    assert (found > 0).sum() > 5


def test_contact_ends_where_a_corner_is_clearly_off():
    heights = np.array([25, 25, 10, 25, 15, 34, 36, 34, 21, 19, 30]) * 1e-3
    corners = np.zeros((len(heights), 1, 3))
    corners[:, 0, 2] = heights
    touches, _ = touching(corners, fps=2.0)  # 0.03 m/s at most
    assert touches[:, 0].astype(int).tolist() == [1, 1, 1, 1, 1, 1, 0, 0, 0, 1, 1]


def test_the_zero_moment_point_is_where_the_force_acts():
    point, force = np.array([0.3, -0.2, 0.0]), np.array([20.0, -10.0, 300.0])
    twist = np.array([0.0, 0.0, 4.0])
    assert zero_moment_point(force, np.cross(point, force) + twist) == pytest.approx(point[:2])


def test_forces_of_many_frames_are_those_of_lawson_and_hanson():
    """Of feet that slip, tip, pull, stand on one corner or on none."""
    n, rng = 150, np.random.default_rng(4)
    corners = np.tile(np.concatenate([SQUARE * 0.1, SQUARE * 0.1 + (0.4, 0, 0)]), (n, 1, 1))
    corners += 0.01 * rng.normal(size=corners.shape)
    touches = rng.random((n, 8)) < rng.random((n, 1))
    force = rng.normal(size=(n, 3)) * (60, 60, 200) + (0, 0, 300)
    moment = np.cross(rng.normal(size=(n, 3)) * (0.3, 0.1, 0), force)
    forces = floor_forces(corners, touches, force, moment)
    assert not forces[~touches].any()
    edges = FRICTION * np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]) + (0, 0, 1)
    for k in np.flatnonzero(touches.any(axis=1)):
        on = corners[k, touches[k]]
        centre = on.mean(axis=0)
        push = np.tile(edges, (len(on), 1))
        lever = np.cross(np.repeat(on - centre, 4, axis=0), push)
        factors = np.vstack([push.T, lever.T, 1e-3 * np.eye(len(push))])
        asked = np.zeros(len(factors))
        asked[:6] = *force[k], *(moment[k] - np.cross(centre, force[k]))
        expected = nnls(factors, asked)[0].reshape(-1, 4) @ edges
        np.testing.assert_allclose(forces[k, touches[k]], expected, rtol=0, atol=1e-6)
