"""Which revision moves, from the torques of a robot on its way to the first frame."""

from __future__ import annotations

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


def fitted(models, revision, support, feedforward):
    """The position that RAMP on a simulated robot gives, with noise on what is measured."""
    rng = np.random.default_rng(1)

    def noise(state):
        for values, deviation in (
            (state.q, 1e-4),
            (state.dq, 1e-2),
            (state.tau_est, 0.1),
            (state.gyroscope, 1e-2),
            (state.accelerometer, 0.1),
        ):
            values[:] = rng.normal(values, deviation)

    config = load_config(None, {"robot": revision, "stream.hold": 0.0})
    session = rollout(
        "demo",
        support=support,
        feedforward=feedforward,
        config=config,
        seconds=0.1,
        noise=noise,
    )
    states, fit = session.sel("RAMP").measured, RevisionFit(support, models)
    imus = zip(states.imu_quat_wxyz, states.gyroscope, states.accelerometer, strict=True)
    for k, imu in enumerate(imus):
        joints = states.q[k], states.dq[k], states.tau[k]
        fit.add(Reading(*joints, ImuReading(*imu), received=2_000_000 * k))
    return fit.position


@pytest.mark.slow
@pytest.mark.parametrize(
    ("expected", "support", "feedforward"),
    [
        (0, "bolted", "velocity"),
        (0, "hanging", "dynamics"),
        (1, "bolted", "dynamics"),
        (1, "hanging", "velocity"),
    ],
)
def test_the_simulated_revision_is_recognised(models, expected, support, feedforward):
    position = fitted(models, REVISIONS[expected], support, feedforward)
    assert position == pytest.approx(expected, abs=0.25)


@pytest.mark.slow
def test_nothing_is_said_of_two_models_that_are_equal(models):
    assert fitted((models[0], models[0]), REVISIONS[0], "bolted", "velocity") is None


def test_readings_that_are_not_finite_are_left_out(models):
    fit = RevisionFit("bolted", models)
    rest, imu = np.zeros(29), ImuReading(np.full(4, np.nan), np.zeros(3), np.zeros(3))
    for k in range(300):
        fit.add(Reading(rest, rest, rest, imu, received=2_000_000 * k))
    assert fit.position is None
