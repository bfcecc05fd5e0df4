import pytest

from g1stream.control.targets import Target
from g1stream.extras.physics.example_motions import squatting
from g1stream.extras.physics.stance import stand
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.model import G1


@pytest.fixture(scope="session")
def squats():
    """Squats of a robot on its feet."""
    return Trajectory(stand(squatting(2.0), G1.default()).motion)


@pytest.fixture(scope="session")
def demo():
    """The right foot stands at 7.5 s, is lifted at 8.6 s for 0.4 s, and is up by 9 cm at 8.67 s."""
    return Trajectory(stand(load_motion("demo"), G1.default()).motion)


@pytest.fixture(scope="session")
def first(squats):
    return Target.from_point(0.0, squats.sample(0.0)).at_rest()
