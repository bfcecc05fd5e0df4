import numpy as np
import pytest

from g1stream.dds.messages import LowCmd
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES, N_JOINTS
from g1stream.sim.robot import MODE_MACHINE_29
from g1stream.sim.world import MotorCommand
from known_robots import real_clip, reference_urdf, robot

__all__ = ["real_clip", "reference_urdf", "robot"]


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def inner_pose(robot, rng):
    """A pose well inside every joint's limits."""
    middle, span = (robot.lower + robot.upper) / 2, robot.upper - robot.lower
    return middle + span * rng.uniform(-0.3, 0.3, N_JOINTS)


@pytest.fixture(scope="session")
def servo():
    """Makes a command, Unitree's gains and zero targets unless given."""

    def make(q=0.0, dq=0.0, tau=0.0, kp=EXAMPLE_KP, kd=EXAMPLE_KD, enabled=True):
        numbers = (np.broadcast_to(value, N_JOINTS).astype(float) for value in (q, dq, tau, kp, kd))
        return MotorCommand(np.broadcast_to(enabled, N_JOINTS), *numbers)

    return make


@pytest.fixture
def command():
    """A LowCmd that moves the left knee to 0.5 rad."""
    command = LowCmd()
    command.motor_mode = 1
    command.mode_machine[()] = MODE_MACHINE_29
    command.kp[:], command.kd[:] = 60.0, 2.0
    command.q[JOINT_NAMES.index("left_knee_joint")] = 0.5
    return command


@pytest.fixture(scope="session")
def run():
    """Advances a world by seconds of its time under one command."""

    def advance(world, command, seconds):
        for _ in range(round(seconds / world.timestep)):
            world.step(command)

    return advance
