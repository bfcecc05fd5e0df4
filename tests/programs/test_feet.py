"""A simulated robot on its own feet: it stands, is pushed, and falls safely."""

from __future__ import annotations

import numpy as np
import pytest

from g1stream.config import Config
from g1stream.control.feedforward import FeedForward
from g1stream.errors import ConfigError, MotionError, SafetyError
from g1stream.programs.rollout import rollout
from g1stream.programs.standing import refuse_feet_on_robot
from g1stream.programs.stream import with_robot_limits
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_normalize
from g1stream.synthetic import squatting

pytest.importorskip("daqp")

SHORT = {"ramp": 1.5, "hold": 0.2, "damp": 0.5}


def config(**stream):
    return Config.model_validate({"stream": SHORT | stream})


def noise():
    rng = np.random.default_rng(7)

    def add(state):
        state.q[:29] += rng.normal(0.0, 5e-4, 29)
        state.dq[:29] += rng.normal(0.0, 0.05, 29)
        state.gyroscope[:] += rng.normal(0.0, 0.01, 3)
        state.accelerometer[:] += rng.normal(0.0, 0.1, 3)
        state.quaternion[:] = quat_normalize(state.quaternion + rng.normal(0.0, 5e-4, 4))

    return add


@pytest.fixture(scope="module")
def session():
    return rollout(squatting(3.0), support="feet", config=config(), noise=noise())


@pytest.mark.slow
def test_it_stands_and_follows_the_reference(session):
    played = session.metadata["stream"]
    assert played["reason"] == ""
    assert played["support"] == "feet"
    assert len(session.metadata["motion"]["operations"]) == 1  # it was changed to stand
    assert session.tracking().overall < 0.004
    playing = session.base.time < 3.0
    assert session.base.position[playing, 2].min() > 0.6


@pytest.mark.slow
def test_the_feet_take_the_weight_before_the_robot_is_let_go(session):
    """Without that the legs would give way by several mm, and the pelvis drop."""
    after = (session.base.time > 0.0) & (session.base.time < 0.1)
    assert np.abs(session.base.velocity[after, 2]).max() < 0.05


def test_a_motion_that_lifts_a_foot_is_refused():
    with pytest.raises(MotionError, match="frames 285 to 294"):
        rollout("demo", support="feet")


def test_it_needs_torques():
    with pytest.raises(ConfigError, match="torques"):
        rollout(squatting(1.0), support="feet", feedforward="velocity")


def test_off_loopback_the_torques_have_to_be_asked_for_as_the_remedy_says():
    def made(**stream):
        given = {"support": "feet", "experimental_feet": True} | stream
        off_loopback = Config.model_validate({"dds": {"interface": "eth0"}, "stream": given})
        settings = with_robot_limits(off_loopback).stream
        return FeedForward.from_config(settings, G1.default(), 0.002)

    with pytest.raises(ConfigError) as refused:
        made()
    assert "--feedforward dynamics" in refused.value.remedy
    assert made(feedforward="dynamics").kind == "dynamics"


def test_where_there_may_be_a_robot_it_has_to_be_allowed():
    def asked(**stream):
        return Config.model_validate(
            {"dds": {"interface": "eth0"}, "stream": {"support": "feet"} | stream}
        )

    with pytest.raises(SafetyError, match="eth0"):
        refuse_feet_on_robot(asked())
    refuse_feet_on_robot(asked(experimental_feet=True))
    refuse_feet_on_robot(asked(support="hanging"))
    refuse_feet_on_robot(config(support="feet"))
