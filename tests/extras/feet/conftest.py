import pytest

from g1stream.control.targets import Setpoint
from g1stream.extras.physics.example_motions import squatting
from g1stream.extras.physics.stance import stand
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.model import G1


@pytest.fixture(scope="session")
def squats():
    """Squats of a robot on its feet."""
    return Trajectory(stand(squatting(2.0), G1.default()).motion)


@pytest.fixture(scope="session")
def demo(standing_demo):
    return Trajectory(standing_demo.motion)


@pytest.fixture(scope="session")
def first(squats):
    return Setpoint.from_point(0.0, squats.sample(0.0)).at_rest()
