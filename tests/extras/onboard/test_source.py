"""Torques of arms and waist, for which the attitude of the pelvis is measured."""

import logging

import numpy as np
import pytest

from g1stream.config import load_config
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.sources import Moment
from g1stream.control.targets import Setpoint
from g1stream.extras.onboard.source import CarriedTorques
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.model import G1
from g1stream.types import Phase

ROBOT = G1.default()
TARGET = Setpoint.from_point(1.0, Trajectory(load_motion("demo")).sample(1.0))


def commanded(source, quat, rate, arrived=0):
    imu = ImuReading(np.array(quat), np.array(rate), np.array([0.0, 0.0, 9.81]))
    measured = Reading(TARGET.q, TARGET.dq, TARGET.tau, imu, arrived=arrived)
    return source.command(Moment(Phase.PLAY, 1.0, TARGET, measured, 0.002))


def test_the_measured_attitude_decides_and_a_robot_that_walks_contradicts_no_support():
    source = CarriedTorques(load_config(), ROBOT, simulated=True)
    mode = source.begin(TARGET, "follow", ROBOT.name)
    assert mode == ("dynamics", None, ROBOT.name)
    quat, rng = [0.8, 0.6, 0.0, 0.0], np.random.default_rng(1)
    base = BaseMotion(np.array(quat), np.zeros(3))
    held = InverseDynamics(ROBOT).solve("bolted", TARGET.q, TARGET.dq, TARGET.ddq, base)
    assert commanded(source, quat, np.zeros(3)).tau == pytest.approx(held.tau)
    for tick in range(2000):
        commanded(source, quat, rng.normal(size=3), arrived=2_000_000 * tick)
    assert source.status.fault == ""


@pytest.mark.parametrize(
    ("announced", "kind", "expected", "level"),
    [
        (None, None, "velocity", logging.WARNING),
        (None, "dynamics", "dynamics", logging.INFO),
        ("follow", "none", "none", logging.WARNING),
    ],
)
def test_a_robot_sags_without_torque_and_says_so(caplog, announced, kind, expected, level):
    caplog.set_level("INFO", logger="g1stream")
    config = load_config(over={"stream.feedforward": kind})
    source = CarriedTorques(config, ROBOT, simulated=True)
    assert source.begin(TARGET, announced, ROBOT.name).kind == expected
    assert [record.levelno for record in caplog.records] == [level]
