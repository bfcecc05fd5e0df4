"""Balance: its forces against statics, and when it gives up."""

from __future__ import annotations

import numpy as np
import pytest

from g1stream.analysis.stance import stand
from g1stream.control.state_checks import ImuReading
from g1stream.control.targets import Target
from g1stream.control.torques import Reading
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_rpy, quat_mul
from g1stream.session.motions import load_motion
from g1stream.synthetic import squatting

pytest.importorskip("daqp")
from g1stream.control.balance import Balance

ROBOT = G1.default()
PERIOD = 0.002


@pytest.fixture(scope="module")
def first():
    return Target.of(0.0, Trajectory(stand(squatting(2.0), ROBOT).motion).sample(0.0)).at_rest()


@pytest.fixture
def balance(first):
    balance = Balance(ROBOT, PERIOD)
    balance.begin(first)
    return balance


def reading(first, tau=None, rpy=(0.0, 0.0, 0.0)):
    quat = quat_mul(quat_from_rpy(np.array(rpy)), first.root_quat_wxyz)
    imu = ImuReading(quat, np.zeros(3), np.array([0.0, 0.0, 9.81]))
    return Reading(first.q, np.zeros(29), np.zeros(29) if tau is None else tau, imu)


def settle(balance, first, seconds, **given):
    """The torques after a robot has stood for a time with the torques that were asked for."""
    tau = balance.torque(first, reading(first, **given), 0.0, share=1.0)
    for _ in range(round(seconds / PERIOD)):
        tau = balance.torque(first, reading(first, tau, **given), 0.0)
    return tau


def test_at_rest_the_floor_carries_the_weight_evenly(balance, first):
    settle(balance, first, 2.0)
    left, right = balance.wrench.reshape(2, 6)
    weight = 33.34 * 9.81
    assert left[2] + right[2] == pytest.approx(weight, rel=2e-3)
    assert left[2] == pytest.approx(right[2], rel=0.05)
    assert np.abs(left + right)[:2] == pytest.approx([0.0, 0.0], abs=1.0)
    assert balance.carried == pytest.approx(1.0, abs=0.01)
    balance.watch(first)
    assert balance.fall == balance.fault == ""
    assert balance.base.pos == pytest.approx(first.root_pos, abs=1e-6)


def test_a_target_that_is_lifted_before_the_feet_stand_pulls_nowhere(balance, first):
    lifted = first.replace(root_pos=first.root_pos + np.array([0.0, 0.0, 0.4]))
    low = balance.torque(first, reading(first), 0.0, planted=False)
    balance.begin(first)
    high = balance.torque(lifted, reading(first), 0.0, planted=False)
    assert high == pytest.approx(low)


def test_what_the_band_carries_is_left_to_it(balance, first):
    """Torques of half the weight, at rest: something else carries the other half."""
    half = balance.torque(first, reading(first), 0.0, share=0.5, planted=False)
    for _ in range(1000):
        balance.torque(first, reading(first, half), 0.0, planted=False)
    assert balance.carried == pytest.approx(0.5, abs=0.02)
    assert balance.wrench[[2, 8]].sum() == pytest.approx(0.5 * 33.34 * 9.81, rel=0.02)


def test_a_drift_of_heading_is_no_turn_of_the_robot(balance, first):
    settle(balance, first, 0.1, rpy=(0.0, 0.0, 0.7))
    assert balance.base.quat_wxyz == pytest.approx(first.root_quat_wxyz, abs=1e-3)
    assert balance.base.pos == pytest.approx(first.root_pos, abs=1e-3)


def test_the_heading_of_the_imu_is_none_of_the_robot_while_the_feet_are_on_their_way(
    balance, first
):
    straight = balance.torque(first, reading(first), 0.0, share=0.5, planted=False)
    balance.begin(first)
    yawed = reading(first, rpy=(0.0, 0.0, 0.5))
    balance.torque(first, yawed, 0.0, share=0.5, planted=False)  # finds it
    for _ in range(4):
        tau = balance.torque(first, yawed, 0.0, share=0.5, planted=False)
        assert balance.base.quat_wxyz == pytest.approx(first.root_quat_wxyz, abs=1e-9)
        assert tau == pytest.approx(straight, abs=1e-3)


@pytest.mark.parametrize(
    ("rpy", "why"), [((0.6, 0.0, 0.0), "tilted"), ((0.0, -0.6, 0.0), "tilted")]
)
def test_a_tilted_robot_is_given_up_at_once(balance, first, rpy, why):
    balance.torque(first, reading(first, rpy=rpy), 0.0)
    balance.watch(first)
    assert why in balance.fall


def test_feet_that_carry_nothing_are_given_up(balance, first):
    for _ in range(150):
        balance.torque(first, reading(first), 0.0)
        balance.watch(first)
    assert "the feet carry" in balance.fall


def test_forces_stay_within_what_the_floor_can_give(balance, first):
    """Leant over as far as it may be, every force pushes, and none is outside of its sole."""
    for angle in (-0.3, -0.1, 0.1, 0.3):
        for rpy in ((angle, 0.0, 0.0), (0.0, angle, 0.0)):
            balance.begin(first)
            balance.torque(first, reading(first, rpy=rpy), 0.0)
            turn = balance.terms.turns
            for foot, wrench in enumerate(balance.wrench.reshape(2, 6)):
                force, moment = turn[foot].T @ wrench[:3], turn[foot].T @ wrench[3:]
                assert force[2] > 0.0
                assert np.abs(force[:2]).max() <= 0.4 * force[2] + 1e-6
                assert abs(moment[0] / force[2]) < 0.03
                assert -0.13 < -moment[1] / force[2] < 0.13


def test_a_foot_that_the_reference_lifts_carries_nothing(balance):
    """In the demo, the right foot is up by 9 cm at 8.67 s."""
    trajectory = Trajectory(stand(load_motion("demo"), ROBOT).motion)
    lifting = Target.of(8.67, trajectory.sample(8.67))
    balance.begin(Target.of(7.5, trajectory.sample(7.5)))
    balance.torque(lifting, reading(lifting), 0.0)
    left, right = balance.wrench.reshape(2, 6)
    assert not right.any()
    assert left[2] > 250.0
    assert balance.base.pos == pytest.approx(lifting.root_pos, abs=2e-3)
