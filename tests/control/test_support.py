"""Right and wrong supports: on our simulator, and in extracts of sessions on unitree_mujoco."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from g1stream.app.rollout import rollout
from g1stream.config import load_config
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.robot_clock import RobotClock
from g1stream.control.support import SupportCheck
from g1stream.robot.dynamics import InverseDynamics
from g1stream.robot.model import G1
from g1stream.types import Support

EXTRACTS = Path(__file__).parents[1] / "data" / "unitree_mujoco"
SETTINGS = {
    "record.channels": "raw",
    "safety.max_joint_speed": 1e3,
    "stream.ramp": 1.0,
    "stream.hold": 0.0,
    "stream.damp": 0.5,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("held", "told"), [("hanging", "bolted"), ("bolted", "hanging"), ("free", "hanging")]
)
def test_a_wrong_support_that_the_bridge_does_not_announce_is_found(held, told):
    config = load_config(None, SETTINGS | {"stream.support": told})
    session = rollout("demo", support=held, feedforward="dynamics", config=config, seconds=3.0)
    (change,) = session.summary().stream.feedforward_changes
    assert change.kind == "velocity"
    assert told in change.reason
    assert 1.5 < change.motion_time_s < 3.0


@pytest.mark.parametrize("name", ["cpp", "cpp_swinging", "python", "python_stalling"])
def test_a_robot_that_hangs_in_unitree_mujoco_is_taken_to_hang(name):
    """Though it swings, its arms press on the torso, time stalls, and states are repeated."""
    dynamics, clock = InverseDynamics(G1.load("g1_29dof")), RobotClock()
    checks = {support: SupportCheck(dynamics, support) for support in get_args(Support)}
    with np.load(EXTRACTS / f"{name}.npz") as recorded:
        columns = [recorded[key] for key in ("time", "q", "dq", "quat", "gyro", "accelerometer")]
    for time, q, dq, quat, gyroscope, accelerometer in zip(*columns, strict=True):
        imu = ImuReading(quat, gyroscope, accelerometer)
        measured = Reading(q, dq, np.zeros(29), imu, arrived=round(1e9 * time))
        clock.take(measured, moving=True)
        for check in checks.values():
            check.add(measured, np.zeros(3), clock.scale)
    assert [support for support, check in checks.items() if not check.wrong] == ["hanging"]


@pytest.mark.parametrize("support", get_args(Support))
def test_a_robot_that_does_not_move_is_not_judged(support):
    check = SupportCheck(InverseDynamics(G1.default()), support)
    rng, rest = np.random.default_rng(3), np.zeros(29, np.float32)
    for k in range(2000):
        turning = rng.normal(0.0, 0.01, 3)
        imu = ImuReading(np.array([1.0, 0, 0, 0]), turning, np.array([0, 0, 9.81]))
        measured = Reading(rest, rng.normal(0.0, 0.01, 29), rest, imu, arrived=2_000_000 * k)
        check.add(measured, np.zeros(3))
    assert check.wrong == (support == "hanging")  # which a pose that does not hang level is not
