import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.config import SafetyConfig
from g1stream.control.monitor import RobotMonitor
from g1stream.control.reading import Reading
from g1stream.dds.messages import LowState
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES, TORQUE_LIMIT
from known_robots import thresholds

MS = 1_000_000
KNEE = JOINT_NAMES.index("left_knee_joint")


class Watched:
    """A robot that publishes every `period` ns, watched."""

    def __init__(self, robot, period=2 * MS, **settings):
        self.monitor = RobotMonitor(robot, robot.present, *thresholds(**settings), period)
        self.period = period
        self.state = LowState()
        self.state.quaternion[0] = 1.0
        self.now = 5_000 * MS
        self.target = np.zeros(29)
        self.measuring = True

    def after(self, seconds, motion=lambda t: None):
        """The kind of the stop within some time, or "", and how long it took, s."""
        step = self.period / 1e9
        for i in range(round(seconds / step)):
            self.now += self.period
            if self.measuring:
                self.state.gyroscope[0] += 0.001
            motion(i * step)
            measured = Reading.from_low_state(self.state, self.now)
            if stop := self.monitor.stop(self.state, measured, self.now, self.target):
                self.text = stop.text
                return stop.kind, (i + 1) * step
        return "", seconds


@pytest.fixture
def make(robot):
    return lambda **settings: Watched(robot, **settings)


@pytest.mark.parametrize(("angle", "stops"), [(0.799, False), (0.801, True)])
def test_tilt(make, angle, stops):
    it = make(max_tilt=0.8)
    turned = Rotation.from_euler("z", 0.7) * Rotation.from_rotvec([0, angle, 0])
    it.state.quaternion[:] = np.roll(turned.as_quat(), 1)
    reason, passed = it.after(0.1)
    assert (reason == "tilt") == stops
    assert not stops or passed == 0.002


@pytest.mark.parametrize(
    ("support", "angle", "stops"),
    [
        ("free", 1.01, True),
        ("feet", 1.01, True),
        ("free", 0.99, False),
        ("hanging", 2.0, False),  # a dance swings it so
        (None, 2.0, False),  # unitree_mujoco does not announce its band
    ],
)
def test_without_a_setting_the_tilt_depends_on_how_the_robot_is_held(make, support, angle, stops):
    it = make()
    it.state.quaternion[:] = 0, 1, 0, 0
    assert it.after(0.1)[0]  # before it begins: upside down
    it.monitor.max_tilt = SafetyConfig().tilt_limit(support)
    it.state.quaternion[:] = np.roll(Rotation.from_rotvec([angle, 0, 0]).as_quat(), 1)
    assert bool(it.after(0.1)[0]) == stops
    robot = make(max_tilt=0.5)
    robot.monitor.max_tilt = SafetyConfig(max_tilt=0.5).tilt_limit(support)
    robot.state.quaternion[:] = it.state.quaternion
    assert robot.after(0.1)[0]


@pytest.mark.parametrize(("speed", "stops"), [(-12.5, False), (-12.51, True), (12.51, True)])
def test_joint_speed(make, speed, stops):
    it = make(max_joint_speed=12.5)
    it.state.dq[KNEE] = speed
    it.state.dq[5] = 12.0
    reason, passed = it.after(0.1)
    assert (reason == "speed") == stops
    assert not stops or passed == 0.002


@pytest.mark.parametrize(
    ("part", "name", "commanded"), [(0, "casing", True), (1, "winding", False)]
)
def test_temperature(make, part, name, commanded):
    it = make(**{f"max_{name}_temperature": 70.0})
    it.target = it.target if commanded else None
    it.state.temperature[KNEE, part] = 70
    assert it.after(0.1)[0] == ""
    it.state.temperature[KNEE, part] = 71
    reason, passed = it.after(0.1)
    assert reason == "temperature"
    assert f"the {name} of left_knee_joint has 71" in it.text
    assert passed <= 0.022


@pytest.mark.parametrize("measuring", [True, False])
def test_voltage(make, measuring):
    """In the clock's time, also where measurements repeat themselves."""
    it = make(min_voltage=42.0, frozen_timeout=2.0)
    it.measuring = measuring
    it.state.vol[:] = 48.0
    it.state.vol[KNEE] = 0.0  # not measured
    assert it.after(1.0)[0] == ""
    it.state.vol[KNEE] = 41.5
    assert it.after(0.45)[0] == ""  # a dip
    it.state.vol[KNEE] = 48.0
    assert it.after(0.1)[0] == ""
    it.state.vol[KNEE] = 41.5
    reason, passed = it.after(1.0)
    assert reason == "voltage"
    assert passed == pytest.approx(0.5, abs=0.042)


def test_a_motor_that_is_off(make):
    it = make(motor_fault_time=0.1)
    it.state.motor_mode = 0  # a simulator does not say
    assert it.after(1.0)[0] == ""
    it.state.motor_mode = 1
    assert it.after(0.1)[0] == ""
    it.state.motor_mode = np.where(np.arange(29) == KNEE, 0, 1)
    reason, passed = it.after(1.0)
    assert reason == "motor"
    assert passed == pytest.approx(0.1, abs=0.042)
    it.state.motor_mode = 0
    assert it.after(1.0)[0] == "motor"
    assert "one of 29" in it.text


@pytest.mark.parametrize("period", [2 * MS, 20 * MS])
def test_a_motor_that_reports_a_fault_as_long_at_every_rate(make, period):
    it = make(period=period, motor_fault_time=0.5)
    it.state.motorstate[KNEE] = 0x201
    reason, passed = it.after(1.0)
    assert reason == "motor"
    assert "0x201: overcurrent, winding overheating" in it.text
    assert passed == pytest.approx(0.5, abs=0.042)


def test_a_fault_that_is_masked_or_short_does_not_stop(make):
    it = make(motor_fault_mask=0xFFFFFFFF & ~0x80000, motor_fault_time=0.1)
    it.state.motorstate[KNEE] = 0x80000
    assert it.after(1.0)[0] == ""
    it.state.motorstate[KNEE] = 0x40000000
    assert it.after(0.08)[0] == ""
    it.state.motorstate[KNEE] = 0
    assert it.after(1.0)[0] == ""


def test_torque(make, robot):
    it = make(max_torque=1.1, torque_time=0.2)
    limit = min(TORQUE_LIMIT[KNEE], robot.effort[KNEE])
    it.state.tau_est[KNEE] = -1.09 * limit
    assert it.after(1.0)[0] == ""
    it.state.tau_est[KNEE] = -1.11 * limit
    reason, passed = it.after(1.0)
    assert reason == "torque"
    assert f"{1.11 * limit:.1f} N·m" in it.text
    assert passed == pytest.approx(0.2, abs=0.042)


def test_tracking_error_is_averaged(make):
    """A constant error e passes the limit after -T ln(1 - limit / e)."""
    it = make(max_tracking_error=0.3, tracking_time=1.0)
    it.target[KNEE] = 0.29
    assert it.after(4.0)[0] == ""
    it = make(max_tracking_error=0.3, tracking_time=1.0)
    it.target[KNEE] = 0.6
    reason, passed = it.after(3.0)
    assert reason == "tracking"
    assert it.text.startswith("left_knee_joint is 0.60 rad")
    assert passed == pytest.approx(np.log(2), abs=0.05)


def test_a_target_beyond_the_limits_is_no_tracking_error(make, robot):
    it = make(max_tracking_error=0.3)
    it.target[KNEE], it.target[5] = 100.0, -100.0
    it.state.q[KNEE], it.state.q[5] = robot.upper[KNEE], robot.lower[5]
    assert it.after(3.0)[0] == ""


def test_a_robot_that_stands_still_is_no_excuse_for_long(make):
    it = make(max_tracking_error=0.3, tracking_time=1.0, frozen_timeout=2.0)
    it.target[KNEE] = 0.6
    it.measuring = False
    assert it.after(10.0)[1] == pytest.approx(2.0 + np.log(2), abs=0.1)


def test_time_without_new_measurements_does_not_count(make):
    """A starved simulator: one new measurement in 20 ms counts 5 ms."""
    it = make(max_tracking_error=0.3, tracking_time=1.0)
    it.target[KNEE] = 0.6
    it.measuring = False

    def seldom(t):
        it.state.gyroscope[0] = t // 0.02

    assert it.after(10.0, seldom)[1] == pytest.approx(4 * np.log(2), rel=0.1)


@pytest.mark.parametrize(
    ("amplitude", "share", "stops"),
    [(0.3, 0.0, True), (0.3, 0.09, True), (0.3, 0.11, False), (0.24, 0.0, False)],
)
def test_a_jam(make, amplitude, share, stops):
    it = make(jam_time=1.0, jam_motion=0.5, max_tracking_error=6.0)

    def swing(t):
        it.target[KNEE] = 0.6 + amplitude * np.sin(4 * t)
        it.state.q[KNEE] = 0.6 + share * amplitude * np.sin(4 * t)

    reason, passed = it.after(3.0, swing)
    assert (reason == "jam") == stops
    assert not stops or passed == pytest.approx(1.0, abs=0.15)


def test_a_robot_that_never_moves_does_not_play_the_demo(make):
    it, motion = make(), load_motion("demo")

    def play(t):
        it.target[:] = motion.joint_pos[int(t * motion.fps)]

    it.state.q[:] = motion.joint_pos[0]
    reason, passed = it.after(motion.duration, play)
    assert reason
    assert passed < motion.duration / 2
