import importlib.util
from pathlib import Path

import numpy as np
import pytest

from g1stream.motion.check import check_motion
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.hulls import SelfCollision

TOOL = Path(__file__).parents[2] / "tools" / "make_demo_motion.py"


@pytest.fixture(scope="module")
def demo():
    return load_motion("demo")


def test_the_tool_generates_the_committed_file(demo, robot):
    spec = importlib.util.spec_from_file_location("make_demo_motion", TOOL)
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert tool.to_csv(*tool.make(robot)).encode() == demo.source.read_bytes()


def test_stays_well_within_the_robots_limits(demo, robot):
    assert (demo.joint_pos >= 0.9 * robot.lower).all()
    assert (demo.joint_pos <= 0.9 * robot.upper).all()
    fastest = check_motion(demo, robot).streamed.speeds[0]
    assert fastest.value < 0.9 * fastest.limit


def test_begins_and_ends_at_rest_in_one_pose(demo):
    trajectory = Trajectory(demo)
    for t in (0.0, demo.duration):
        point = trajectory.sample(t)
        assert np.abs(point.joint_vel).max() < 1e-3
        assert np.abs(point.root_lin_vel).max() < 1e-3
        assert np.abs(point.root_ang_vel).max() < 1e-3
    np.testing.assert_allclose(demo.joint_pos[-1], demo.joint_pos[0], atol=1e-5)
    np.testing.assert_allclose(demo.root_pos[-1], demo.root_pos[0], atol=1e-5)


def test_needs_less_than_half_of_the_torque_limits(demo, robot):
    """With the pelvis held, as the bridge holds it by default."""
    dynamics, trajectory, torques = InverseDynamics(robot), Trajectory(demo), []
    upright = BaseMotion(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
    for t in np.arange(0.0, demo.duration, 0.1):
        point = trajectory.sample(t)
        joints = point.joint_pos, point.joint_vel, point.joint_acc
        torques.append(dynamics.solve("bolted", *joints, upright).tau)
    share = np.abs(torques).max(axis=0) / robot.effort
    assert 0.05 < share.max() < 0.5, robot.joint_names[int(share.argmax())]


def test_its_links_do_not_touch(demo, robot):
    assert SelfCollision(robot).depths(demo.joint_pos) == {}
