from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, N_JOINTS
from g1stream.sim.world import MotorCommand
from known_robots import reference_urdf, robot

if TYPE_CHECKING:
    from numpy.typing import NDArray


__all__ = ["reference_urdf", "robot"]


class Mass(NamedTuple):
    link: str
    mass: float
    centre: NDArray[np.float64]


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def inner_pose(robot, rng):
    """A pose well inside every joint's limits."""
    middle, span = (robot.lower + robot.upper) / 2, robot.upper - robot.lower
    return middle + span * rng.uniform(-0.3, 0.3, N_JOINTS)


@pytest.fixture(scope="session")
def masses(robot):
    """Each link's mass and its centre in the link's own frame, read from the URDF."""
    found = []
    for link in ET.fromstring(robot.urdf).iter("link"):
        mass, origin = link.find("inertial/mass"), link.find("inertial/origin")
        if mass is not None and origin is not None:
            centre = np.array([float(part) for part in origin.attrib["xyz"].split()])
            found.append(Mass(link.attrib["name"], float(mass.attrib["value"]), centre))
    return found


@pytest.fixture(scope="session")
def servo():
    """Makes a command, Unitree's gains and zero targets unless given."""

    def make(q=0.0, dq=0.0, tau=0.0, kp=EXAMPLE_KP, kd=EXAMPLE_KD, enabled=True):
        numbers = (np.broadcast_to(value, N_JOINTS).astype(float) for value in (q, dq, tau, kp, kd))
        return MotorCommand(np.broadcast_to(enabled, N_JOINTS), *numbers)

    return make


@pytest.fixture(scope="session")
def run():
    """Advances a world by seconds of its time under one command."""

    def advance(world, command, seconds):
        for _ in range(round(seconds / world.timestep)):
            world.step(command)

    return advance
