import numpy as np
import pytest

from g1stream.control.lowstate import LowStateChecks
from g1stream.control.reading import Reading, is_unit
from g1stream.dds.messages import LowState
from g1stream.robot.model import G1
from known_robots import thresholds

MS = 1_000_000
NOW = 5_000 * MS


class Robot:
    """LowStates of a robot at rest, one every 2 ms, into checks."""

    def __init__(self, robot, **settings):
        self.checks = LowStateChecks(robot, robot.present, *thresholds(**settings))
        self.state = LowState()
        self.state.quaternion[:] = (1, 0, 0, 0)
        self.state.mode_machine[()] = 5
        self.now = NOW
        self.publisher = 1
        self.sealed = self.moving = self.ticking = True

    def publish(self, *, times=1, target=None):
        """Publish, and return why the robot is unknown afterwards, or ""."""
        for _ in range(times):
            self.now += 2 * MS
            if self.moving:
                self.state.gyroscope[0] += 0.001
            if self.ticking:
                self.state.tick += np.uint32(2)
            if self.sealed:
                self.state.seal()
            self.checks.take(self.state, self.publisher, self.now, target)
        return self.checks.unknown(self.now, target)


@pytest.fixture
def make(robot):
    return lambda **settings: Robot(robot, **settings)


@pytest.fixture
def begun(make):
    """A robot whose first command follows."""

    def begin(**settings):
        it = make(**settings)
        assert it.publish(times=3) == ""
        it.checks.begin(None)
        return it

    return begin


def test_what_is_measured_is_a_copy(make):
    it = make()
    it.state.q[:], it.state.dq[:], it.state.tau_est[:] = 1.0, 2.0, 3.0
    it.state.accelerometer[:] = (0, 0, 9.81)
    measured = Reading.from_low_state(it.state, NOW)
    it.state.payload[:] = 0
    assert measured.q.tolist() == [1.0] * 29
    assert measured.dq.tolist() == [2.0] * 29
    assert measured.tau.tolist() == [3.0] * 29
    assert measured.imu.quat_wxyz.tolist() == [1, 0, 0, 0]
    assert measured.imu.accelerometer.tolist() == pytest.approx([0, 0, 9.81])
    assert (measured.mode_machine, measured.arrived, measured.finite) == (5, NOW, True)


def test_a_stale_state(make):
    it = make(state_timeout=0.1)
    it.publish()
    assert it.checks.unknown(it.now + 100 * MS) == ""
    reason = it.checks.unknown(it.now + 100 * MS + 1)
    assert reason.startswith("no LowState for 0.100 s")
    assert "safety.state_timeout = 0.1 s" in reason


@pytest.mark.parametrize(
    ("field", "bad", "named"),
    [
        ("q", np.nan, "position of left_ankle_roll_joint"),
        ("dq", np.inf, "velocity of left_ankle_roll_joint"),
        ("tau_est", -np.inf, "torque of left_ankle_roll_joint"),
        ("quaternion", np.nan, "quaternion"),
        ("gyroscope", np.inf, "gyroscope"),
        ("accelerometer", -np.inf, "accelerometer"),
    ],
)
def test_a_number_that_is_not_finite(make, field, bad, named):
    it = make()
    it.state.dq[3] = 1000.0
    values = getattr(it.state, field)
    values[min(5, len(values) - 1)] = bad
    assert named in it.publish()
    assert it.checks.stop is None  # what is not believed is not judged


@pytest.mark.parametrize(
    ("norm", "fine"), [(0.951, True), (1.049, True), (0.949, False), (1.051, False)]
)
def test_an_attitude_is_a_unit_quaternion(make, norm, fine):
    it = make()
    it.state.quaternion *= np.float32(norm)
    assert is_unit(it.state.quaternion) == fine
    assert it.publish() == ("" if fine else f"the IMU quaternion has norm {norm:.3f}")


@pytest.mark.parametrize("side", [-1, 1])
def test_a_pose_beyond_the_limits_is_no_start_and_stops_later(begun, make, robot, side):
    at_stop = robot.upper if side > 0 else robot.lower
    stricter = make(limit_excess=0.05)
    later = begun(max_leap=1.0, limit_excess=0.3)
    for it, most in ((make(), 0.1), (stricter, 0.05), (later, 0.3)):
        it.state.q[:] = at_stop + side * (most - 1e-4)
        it.checks.measured = None  # so that there is no leap
        assert it.publish() == ""
        it.state.q[7] = at_stop[7] + side * (most + 1e-3)
        reason = it.publish()
        assert reason.startswith(robot.joint_names[7])
        assert "beyond its limits" in reason


@pytest.mark.parametrize("provided", [True, False])
def test_a_crc_is_required_where_it_is_provided(begun, provided):
    it = begun()
    it.sealed = False
    it.state.crc[()] = 0 if provided else 1
    if not provided:  # of a bridge that sends none, the first that is not 0 is wrong
        it.checks._has_crc = False
    before = it.checks.measured
    it.publish()
    assert it.checks.measured is before
    assert it.checks.crc_errors == 1
    it.sealed = True
    assert it.publish() == ""
    assert it.checks.measured is not before


def test_only_wrong_crcs_are_no_robot(make):
    it = make()
    assert it.checks.unknown(NOW) == "no LowState received"
    it.sealed = False
    it.state.crc[()] = 7
    reason = it.publish(times=3)
    assert reason == "no LowState received; 3 with a wrong CRC were dropped"


@pytest.mark.parametrize(("gap", "stops"), [(2, True), (400, False)])
def test_wrong_crcs_have_a_budget_for_a_second(begun, gap, stops):
    it = begun(max_crc_errors=3)
    reasons = []
    for _ in range(6):
        it.sealed = False
        it.state.crc[()] = 1
        it.publish()
        it.sealed = True
        reasons.append(it.publish(times=gap // 2))
    assert [bool(reason) for reason in reasons] == [False] * 3 + [stops] * 3
    assert not stops or "more than 3 LowStates" in reasons[-1]


@pytest.mark.parametrize("went", [True, False])
def test_a_tick_that_stands_still_where_it_went(make, went):
    it = make(frozen_timeout=0.1)
    it.ticking = went
    it.publish(times=3)
    it.checks.begin(None)
    it.ticking = False
    assert it.publish(times=50) == ""
    assert ("tick of LowState has been 6 for" in it.publish()) == went


@pytest.mark.parametrize(
    ("frozen_motion", "moved", "stops"),
    [(0.01, 0.0, False), (0.01, 0.009, False), (0.01, 0.011, True), (0.0, 0.0, True)],
)
def test_content_that_repeats_while_the_targets_move(begun, frozen_motion, moved, stops):
    it = begun(frozen_timeout=0.1, frozen_motion=frozen_motion)
    start, later = np.zeros(29), np.zeros(29)
    later[4] = moved
    it.publish(target=start)
    it.moving = False
    assert it.publish(times=50, target=later) == ""
    reason = it.publish(target=later)
    assert bool(reason) == stops
    assert not stops or f"{moved:.3f} rad" in reason


@pytest.mark.parametrize(("ahead", "passed"), [(0, 0.002), (48, 0.05)])
def test_a_leap(begun, robot, ahead, passed):
    """A simulator that catches up does not leap."""
    it, velocity = begun(max_leap=0.5), robot.velocity[3]
    it.state.tick += np.uint32(ahead)
    it.state.q[3] += 0.5 + 0.9 * velocity * passed
    assert it.publish() == ""
    it.state.q[3] -= 0.5 + 1.1 * velocity * 0.002
    reason = it.publish()
    assert reason.startswith("left_knee_joint jumped")
    assert "tolerance of 0.5 rad" in reason


def test_without_a_tick_the_clock_says_how_far_a_joint_may_have_moved(begun, robot):
    it = begun(max_leap=0.5)
    it.ticking = it.moving = False
    assert it.publish(times=50) == ""
    it.state.q[3] += 0.5 + 0.9 * robot.velocity[3] * 0.1
    assert it.publish() == ""


def test_before_the_first_command_a_robot_may_be_replaced(make):
    it = make()
    it.publish(times=3)
    it.publisher, it.sealed = 2, False
    it.state.crc[()] = 0
    it.state.tick[()] = 0
    it.state.q[3] = 1.5
    it.state.mode_machine[()] = 0
    assert it.publish() == ""


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda it: setattr(it, "publisher", 2), "publisher of LowState has changed"),
        (lambda it: it.state.tick.fill(0), "tick of LowState went back from 6 to 2"),
        (lambda it: it.state.mode_machine.fill(0), "mode_machine changed from 5 to 0"),
    ],
)
def test_after_the_first_command_it_is_the_same_robot(begun, change, reason):
    it = begun()
    change(it)
    assert reason in it.publish()
    assert reason in it.publish()  # for good


def test_a_tick_that_wraps_is_no_restart(begun):
    it = begun()
    it.state.tick[()] = 2**32 - 2
    it.checks._tick = 2**32 - 4
    assert it.publish(times=2) == ""


@pytest.mark.parametrize(("name", "allowed"), [("g1_29dof", (0, 5)), ("g1_23dof", (0, 4))])
def test_mode_machine(name, allowed):
    robot = G1.load(name)
    for machine in (0, 4, 5, 6):
        it = Robot(robot)
        it.state.mode_machine[()] = machine
        assert it.publish() == ""
        assert (it.checks.stop is None) == (machine in allowed)
        assert machine in allowed or it.checks.stop.kind == "robot"


@pytest.mark.parametrize("mode_pr", [0, 1])
def test_motors_a_and_b_are_no_joints(make, mode_pr):
    it = make()
    it.state.mode_pr[()] = mode_pr
    assert it.publish() == ""
    assert (it.checks.stop and it.checks.stop.kind) == ("robot" if mode_pr else None)


def test_the_fault_of_one_publisher_is_found_with_the_next_one_too(make):
    it = make()
    it.moving = it.ticking = it.sealed = False
    it.state.quaternion[:] = 0.0
    assert "norm 0.000" in it.publish()
    it.publisher = 2
    assert "norm 0.000" in it.publish()


def test_the_remote_counts_from_the_first_command_on(make):
    it = make(deadman="R1")
    it.state.wireless_remote[2:4] = (0x20, 0x02)
    it.publish()
    assert "safety.deadman" in it.checks.missing
    assert it.checks.stop is None
    it.checks.begin(None)
    it.publish()
    assert it.checks.stop.kind == "operator"


@pytest.mark.parametrize(("interval", "waits"), [(0.09, False), (0.2, True)])
def test_low_states_that_are_seldom_are_no_start(make, interval, waits):
    it = make(state_timeout=1.0)
    it.publish()
    assert it.checks.missing
    for _ in range(5):
        it.now += round(interval * 1e9)
        it.publish()
        assert bool(it.checks.missing) == waits


@pytest.mark.parametrize(("speed", "moved", "stops"), [(2.5, 0.0, True), (1.5, 0.6, False)])
def test_a_speed_that_the_position_does_not_show(begun, robot, speed, moved, stops):
    """One beyond the joint's limit; `moved` is in multiples of what the limit allows."""
    it = begun(max_leap=0.5)
    it.state.dq[3] = speed * robot.velocity[3]
    it.state.q[3] += moved * robot.velocity[3] * 0.002
    assert ("reports" in it.publish()) == stops


def test_a_steady_velocity_is_the_median_of_three_states(make):
    it, found = make(), []
    for value in (1.0, 2.0, 30.0, 3.0, 2.5, np.nan, 4.0, 5.0, 4.5):
        it.state.dq[7], it.state.gyroscope[1] = value, -value
        it.publish()
        measured = it.checks.measured
        found.append(float(measured.steady_dq[7]))
        assert np.array_equal(measured.steady_rate[1], -found[-1], equal_nan=True)
    assert found[:5] == [1.0, 2.0, 2.0, 3.0, 3.0]
    assert np.isnan(found[5])  # such a LowState is not used, and not compared
    assert found[6:] == [4.0, 5.0, 4.5]


def test_a_repeated_state_is_no_confirmation(make):
    it = make()
    it.publish(times=3)
    it.moving, it.ticking = False, False
    it.state.dq[7] = 9.0
    it.publish(times=5)
    assert (it.checks.measured.dq[7], it.checks.measured.steady_dq[7]) == (9.0, 0.0)


@pytest.mark.parametrize(("gap", "steady"), [(16, 1.0), (18, 9.0)])
def test_states_that_are_too_old_confirm_nothing(make, gap, steady):
    """The age of the oldest counts, 2 ms more than the gap before the newest two."""
    it = make()
    it.state.dq[7] = 1.0
    it.publish(times=2)
    it.now += gap * MS
    it.state.dq[7] = 9.0
    it.publish()
    assert it.checks.measured.steady_dq[7] == steady
