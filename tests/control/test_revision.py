"""Which revision moves, from the torques of a robot on its way to the first frame."""

import numpy as np
import pytest

from g1stream.app.rollout import rollout
from g1stream.config import load_config
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.support import RevisionFit
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.model import G1, REVISIONS


@pytest.fixture(scope="module")
def models():
    return tuple(InverseDynamics(G1.load(name)) for name in REVISIONS)


def noise(state):
    rng = np.random.default_rng(int(state.tick))
    for values, deviation in (
        (state.q, 1e-4),
        (state.dq, 1e-2),
        (state.tau_est, 0.1),
        (state.gyroscope, 1e-2),
        (state.accelerometer, 0.1),
    ):
        values[:] = rng.normal(values, deviation)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("expected", "support", "feedforward"), [(0, "bolted", "dynamics"), (1, "hanging", "velocity")]
)
def test_the_simulated_revision_is_recognised(models, expected, support, feedforward):
    """Between two models that are equal, none is."""
    over = {"robot": REVISIONS[expected], "record.channels": "raw"}
    config = load_config(over=over | {"stream.hold": 0.0, "stream.damp": 0.5})
    session = rollout(
        "demo", support=support, feedforward=feedforward, config=config, seconds=0.1, noise=noise
    )
    states = session.sel("RAMP").measured
    fit, equal = RevisionFit(support, models), RevisionFit(support, models[:1] * 2)
    imus = zip(states.imu_quat_wxyz, states.gyroscope, states.accelerometer, strict=True)
    for k, imu in enumerate(imus):
        joints = states.q[k], states.dq[k], states.tau[k]
        measured = Reading(*joints, ImuReading(*imu), received=2_000_000 * k)
        fit.add(measured)
        equal.add(measured)
    assert fit.position == pytest.approx(expected, abs=0.25)
    assert equal.position is None


def test_readings_that_are_not_finite_are_left_out(models):
    fit = RevisionFit("bolted", models)
    rest, imu = np.zeros(29), ImuReading(np.full(4, np.nan), np.zeros(3), np.zeros(3))
    for k in range(300):
        fit.add(Reading(rest, rest, rest, imu, received=2_000_000 * k))
    assert fit.position is None
