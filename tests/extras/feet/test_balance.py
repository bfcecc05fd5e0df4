import numpy as np
import pytest

from g1stream.control.reading import ImuReading, Reading
from g1stream.control.targets import Setpoint
from g1stream.extras.feet.squat import Squat
from g1stream.extras.physics.example_motions import stepping
from g1stream.extras.physics.stance import stand
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_rpy, quat_mul, quat_rotate_inverse
from g1stream.session.records import BalanceSummary

pytest.importorskip("daqp")
from g1stream.extras.feet.balance import Balance

ROBOT = G1.default()
PERIOD = 0.002
WEIGHT = 33.34 * 9.81  # N
ANKLES = [JOINT_NAMES.index(f"{side}_ankle_pitch_joint") for side in ("left", "right")]


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
    settle(balance, first, 1.0)
    left, right = balance.wrench.reshape(2, 6)
    assert left[2] + right[2] == pytest.approx(WEIGHT, rel=2e-3)
    assert left[2] == pytest.approx(right[2], rel=0.05)
    assert np.abs(left + right)[:2] == pytest.approx([0.0, 0.0], abs=1.0)
    assert balance.carried == pytest.approx(1.0, abs=0.01)
    balance.watch(first)
    assert balance.fall == balance.fault == ""
    assert balance.base.pos == pytest.approx(first.root_pos, abs=1e-6)


def test_what_the_band_carries_is_left_to_it(balance, first):
    """Torques of half the weight, at rest: something else carries the other half."""
    half = balance.torque(first, reading(first), 0.0, share=0.5, planted=False)
    for _ in range(500):
        balance.torque(first, reading(first, half), 0.0, planted=False)
    assert balance.carried == pytest.approx(0.5, abs=0.02)
    assert balance.wrench[[2, 8]].sum() == pytest.approx(0.5 * WEIGHT, rel=0.02)


def test_a_drift_of_heading_is_no_turn_of_the_robot(balance, first):
    settle(balance, first, 0.1, rpy=(0.0, 0.0, 0.7))
    assert balance.base.quat_wxyz == pytest.approx(first.root_quat_wxyz, abs=1e-3)
    assert balance.base.pos == pytest.approx(first.root_pos, abs=1e-3)


@pytest.mark.parametrize("rpy", [(0.6, 0.0, 0.0), (0.0, -0.6, 0.0)])
def test_a_tilted_robot_is_given_up_at_once(balance, first, rpy):
    balance.torque(first, reading(first, rpy=rpy), 0.0)
    balance.watch(first)
    assert "tilted" in balance.fall


def test_feet_that_carry_nothing_are_given_up(balance, first):
    for _ in range(150):
        balance.torque(first, reading(first), 0.0)
        balance.watch(first)
    assert "the feet carry" in balance.fall


@pytest.mark.parametrize(("share", "falls"), [(0.9, False), (1.1, True)])
def test_legs_that_give_way_are_given_up(balance, first, share, falls):
    """The pelvis sinks by about 0.1 m, upright, above soles that stay and carry it."""
    target_at, sunk, k = Squat(ROBOT).plan(first), first, 0
    while first.root_pos[2] - sunk.root_pos[2] <= share * 0.1:
        sunk, k = target_at(k * PERIOD, sunk.q), k + 1
    sunk = sunk.at_rest()
    tau = balance.torque(sunk, reading(sunk), 0.0, share=1.0)
    for _ in range(60):
        balance.torque(sunk, reading(sunk, tau), 0.0)
        balance.watch(first)
    assert ("below the reference" in balance.fall) == falls


def test_the_worst_tilt_height_and_load_are_kept(balance, first):
    assert not balance.worst
    settle(balance, first, 0.5)
    balance.watch(first)
    before = BalanceSummary(**balance.worst)
    assert before.tilt_rad < 1e-3
    assert before.height_error_m < 1e-3
    assert before.carried == pytest.approx(1.0, abs=0.01)
    assert 0.03 < before.capture_margin_m < 0.1  # the soles are 0.1 m behind and before the mass
    quat = quat_mul(quat_from_rpy(np.array([0.0, 0.1, 0.0])), first.root_quat_wxyz)
    higher = first.root_pos + np.array([0.0, 0.0, 0.03])
    balance.watch(first._replace(root_quat_wxyz=quat, root_pos=higher))
    balance.watch(first)
    worst = BalanceSummary(**balance.worst)
    assert worst.tilt_rad == pytest.approx(0.1, abs=1e-3)
    assert worst.height_error_m == pytest.approx(0.03, abs=1e-3)
    assert worst.capture_margin_m == before.capture_margin_m
    balance.begin(first)
    assert not balance.worst


def test_the_pelvis_is_found_over_feet_that_have_stepped_elsewhere():
    """A robot that does exactly what the reference asks for, through two steps of a turn."""
    turning = stepping([(0.1, 0.05, 0.5)] * 2, period=1.2)
    trajectory = Trajectory(stand(turning, ROBOT).motion)
    balance = Balance(ROBOT, PERIOD)
    balance.begin(Setpoint.from_point(0.0, trajectory.sample(0.0)).at_rest())
    planted = balance._stood.copy()
    for time in np.arange(0.0, trajectory.duration, PERIOD):
        at = Setpoint.from_point(time, trajectory.sample(time))
        acc = at.root_lin_acc + np.array([0.0, 0.0, 9.81])
        up = quat_rotate_inverse(at.root_quat_wxyz, acc)
        measured = Reading(at.q, at.dq, at.tau, ImuReading(at.root_quat_wxyz, at.root_ang_vel, up))
        balance.torque(at, measured, -0.5 * PERIOD)
        assert balance._capture_point_outside(balance.terms) < 0.01
        assert balance.base.pos == pytest.approx(at.root_pos, abs=2e-3)
        assert balance.base.quat_wxyz == pytest.approx(at.root_quat_wxyz, abs=1e-3)
    moved = balance._stood - planted
    assert moved[:, 0] == pytest.approx(0.1 + 0.1 * np.sin([-0.5, 0.5]), abs=0.01)


def tipping(first, rate):
    """A stiff body that turns about both ankles, forward if the rate is positive, rad/s."""
    dq = np.zeros(29)
    dq[ANKLES] = -rate
    imu = ImuReading(first.root_quat_wxyz, np.array([0.0, rate, 0.0]), np.array([0.0, 0.0, 9.81]))
    return Reading(first.q, dq, np.zeros(29), imu)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_it_falls_where_the_capture_point_leaves_the_soles_by_10_mm(balance, first, way):
    """The capture point of an inverted pendulum, which the robot is while only its ankles turn."""
    balance.torque(first, reading(first), 0.0)
    terms = balance.terms
    poses = forward_kinematics(ROBOT, first.q[None], np.zeros((1, 3)), first.root_quat_wxyz[None])
    ankles = [int(np.flatnonzero(ROBOT.joint_of_link == joint)[0]) for joint in ANKLES]
    height = terms.centre[2] - poses.pos[0, ankles, 2].mean()
    corners = terms.soles[:, np.newaxis] + np.pad(balance._dynamics.sole, ((0, 0), (0, 1)))
    edge = way * max(way * corners[..., 0].ravel())
    time = np.sqrt((terms.centre[2] - terms.soles[:, 2].mean()) / 9.81)
    rate = (edge + way * 0.01 - terms.centre[0]) / (height * time)
    for share, seconds, falls in ((0.97, 0.2, False), (1.03, 0.09, False), (1.03, 0.12, True)):
        balance.begin(first)
        for _ in range(round(seconds / PERIOD)):
            balance.torque(first, tipping(first, share * rate), 0.0)
            balance.watch(first)
        assert ("capture point" in balance.fall) == falls


def test_forces_stay_within_what_the_floor_can_give(balance, first):
    """Leant over as far as it may be, every force pushes, and none is outside of its sole."""
    for angle in (-0.3, 0.1, 0.3):
        for rpy in ((angle, 0.0, 0.0), (0.0, angle, 0.0)):
            balance.begin(first)
            balance.torque(first, reading(first, rpy=rpy), 0.0)
            turn = balance.terms.turns
            for foot, wrench in enumerate(balance.wrench.reshape(2, 6)):
                force, moment = turn[foot].T @ wrench[:3], turn[foot].T @ wrench[3:]
                assert force[2] > 0.0
                assert np.abs(force[:2]).max() <= 0.4 * force[2] + 1e-6
                corners = balance._dynamics.sole
                pressure = np.array([-moment[1], moment[0]]) / force[2]
                assert np.all(pressure >= corners.min(axis=0) + 0.0099)
                assert np.all(pressure <= corners.max(axis=0) - 0.0099)


def test_a_foot_that_the_reference_lifts_carries_nothing(balance, demo):
    planted, lifting = (Setpoint.from_point(time, demo.sample(time)) for time in (7.5, 8.67))
    balance.begin(planted)
    balance.torque(lifting, reading(lifting), 0.0)
    left, right = balance.wrench.reshape(2, 6)
    assert not right.any()
    assert left[2] > 250.0
    assert balance.base.pos == pytest.approx(lifting.root_pos, abs=2e-3)
