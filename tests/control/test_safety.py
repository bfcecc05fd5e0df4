"""Each threshold just on and just beyond it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from g1stream.config import SafetyConfig
from g1stream.control.safety import Envelope, Measured, tilt_of
from g1stream.errors import ConfigError, SafetyError
from g1stream.robot.joints import JOINT_NAMES

NOW = 5_000_000_000


@pytest.fixture
def make_envelope(robot):
    return lambda **settings: Envelope(robot, SafetyConfig(**settings))


@pytest.fixture
def calm():
    """A LowState of this instant with which all is well."""
    upright = np.array([1, 0, 0, 0], np.float32)
    return Measured(np.zeros(29, np.float32), np.zeros(29, np.float32), upright, 5, NOW)


def tilted_by(angle, yaw=0.7):
    """A body that has turned about the vertical and leans by `angle`; quaternion wxyz."""
    x, y, z, w = (Rotation.from_euler("z", yaw) * Rotation.from_rotvec([0, angle, 0])).as_quat()
    return np.array([w, x, y, z])


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, np.pi / 2, 2.5, np.pi])
def test_tilt_is_the_lean_whatever_the_heading(angle):
    for yaw in (-2.0, 0.0, 0.7):
        quat = tilted_by(angle, yaw)
        assert tilt_of(quat) == pytest.approx(angle, abs=1e-7)
        assert tilt_of(-quat) == pytest.approx(angle, abs=1e-7)


def test_tilt_is_the_angle_between_the_vertical_axes():
    for rotation in Rotation.random(50, rng=np.random.default_rng(3)):
        x, y, z, w = rotation.as_quat()
        expected = np.arccos(rotation.apply([0, 0, 1])[2])
        assert tilt_of(np.array([w, x, y, z])) == pytest.approx(expected, abs=1e-7)


def test_targets_within_the_limits_are_left_alone(make_envelope, robot):
    envelope = make_envelope()
    for share in (0.0, 0.5, 1.0):
        q = robot.lower + share * (robot.upper - robot.lower)
        q = np.clip(q, robot.lower, robot.upper)
        assert envelope.limit(q).tolist() == q.tolist()
    assert not envelope.clamped.any()


def test_a_held_target_is_not_driven_on_into_its_limit(make_envelope):
    beyond = np.array([0.2, 0.2, -0.2, -0.2, 0.0])
    dq, tau = np.full(5, 3.0), np.array([5.0, -5.0, 5.0, -5.0, 5.0])
    held_dq, held_tau = make_envelope().keep_inward(beyond, dq, tau)
    assert held_dq.tolist() == [0.0, 0.0, 0.0, 0.0, 3.0]
    assert held_tau.tolist() == [0.0, -5.0, 5.0, 0.0, 5.0]


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_ramp_from_beyond_a_limit_is_let_in_with_the_ramp(make_envelope, robot, side):
    envelope = make_envelope(position_margin=0.1)
    at_stop, inward = getattr(robot, side), 0.1 if side == "lower" else -0.1
    envelope.begin(at_stop)
    assert envelope.limit(at_stop, 0.0).tolist() == at_stop.tolist()
    assert envelope.limit(at_stop, 0.25) == pytest.approx(at_stop + 0.25 * inward)
    assert envelope.limit(at_stop, 1.0) == pytest.approx(at_stop + inward)
    assert envelope.limit(at_stop) == pytest.approx(at_stop + inward)


def test_targets_beyond_a_limit_are_held_and_counted(make_envelope, robot):
    envelope = make_envelope(position_margin=0.1)
    q = (robot.lower + robot.upper) / 2
    q[3] = robot.upper[3] - 0.1 + 1e-5
    q[4] = robot.lower[4] + 0.1 - 1e-5
    q[5] = robot.upper[5] - 0.1 + 1e-9  # a rounding error: held as well, but not counted
    for _ in range(3):
        limited = envelope.limit(q)
        assert limited[3] == robot.upper[3] - 0.1
        assert limited[4] == robot.lower[4] + 0.1
        assert limited[5] == robot.upper[5] - 0.1
    assert np.delete(limited, [3, 4, 5]).tolist() == np.delete(q, [3, 4, 5]).tolist()
    assert envelope.clamped.tolist() == [3 if i in (3, 4) else 0 for i in range(29)]


def test_margin_that_leaves_no_range_is_refused(make_envelope, robot):
    narrowest = np.argmin(robot.upper - robot.lower)
    half = (robot.upper - robot.lower)[narrowest] / 2
    make_envelope(position_margin=half - 1e-9)
    with pytest.raises(ConfigError, match=r"position_margin.*" + JOINT_NAMES[narrowest]):
        make_envelope(position_margin=half + 1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("what", ["q", "dq", "tau"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_target_that_is_not_finite_is_refused(make_envelope, what, bad, dtype):
    targets = {name: np.ones(29, dtype) for name in ("q", "dq", "tau")}
    make_envelope().require_finite(**targets)
    targets[what][11] = bad
    with pytest.raises(SafetyError, match=f"{JOINT_NAMES[11]} has {what} = {bad}"):
        make_envelope().require_finite(**targets)


def test_opposite_infinities_do_not_hide_each_other(make_envelope):
    q = np.array([0, 0, np.inf, -np.inf] + [0] * 25)
    with np.errstate(invalid="ignore"), pytest.raises(SafetyError, match=JOINT_NAMES[2]):
        make_envelope().require_finite(q=q)


def test_all_is_well(make_envelope, calm):
    envelope = make_envelope()
    assert envelope.implausible(NOW, calm) == envelope.verdict(calm) == ""


def test_stale_state(make_envelope, calm):
    envelope = make_envelope(state_timeout=0.1)
    assert envelope.implausible(NOW + 100_000_000, calm) == ""
    assert "no LowState" in envelope.implausible(NOW + 100_000_001, calm)
    assert "safety.state_timeout = 0.1 s" in envelope.implausible(NOW + 100_000_001, calm)
    assert "5.000 s" in envelope.implausible(NOW + 5_000_000_000, calm)


def test_standstill_of_the_loop(make_envelope):
    envelope = make_envelope(state_timeout=0.1)
    assert envelope.stalled(100_000_000) == ""
    assert "stalled for 0.100 s" in envelope.stalled(100_000_001)


def test_tilt(make_envelope, calm):
    envelope = make_envelope(max_tilt=0.8)
    assert envelope.verdict(replace(calm, quat_wxyz=tilted_by(0.8 - 1e-6))) == ""
    too_far = replace(calm, quat_wxyz=tilted_by(0.8 + 1e-6))
    assert "tilt is 0.80 rad" in envelope.verdict(too_far)


def test_joint_speed(make_envelope, calm):
    envelope = make_envelope(max_joint_speed=12.5)
    calm.dq[17] = -12.5
    assert envelope.verdict(calm) == ""
    calm.dq[17] = np.nextafter(np.float32(-12.5), np.float32(-13))
    calm.dq[3] = 12.5
    reason = envelope.verdict(calm)
    assert JOINT_NAMES[17] in reason


@pytest.mark.parametrize(("machine", "allowed"), [(5, True), (0, True), (4, False), (6, False)])
def test_mode_machine(make_envelope, calm, machine, allowed):
    reason = make_envelope().verdict(replace(calm, mode_machine=machine))
    assert (reason == "") is allowed
    if not allowed:
        assert f"mode_machine {machine}" in reason
        assert "0, 5" in reason
    assert make_envelope(mode_machine=[machine]).verdict(replace(calm, mode_machine=machine)) == ""


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["q", "dq"])
def test_a_state_that_is_not_finite(make_envelope, calm, field, bad):
    getattr(calm, field)[5] = bad
    assert "NaN or infinite" in make_envelope().implausible(NOW, calm)


@pytest.mark.parametrize(
    ("norm", "fine"), [(1.0, True), (0.951, True), (1.049, True), (0.949, False), (1.051, False)]
)
def test_an_attitude_must_be_one(make_envelope, calm, norm, fine):
    reason = make_envelope().implausible(NOW, replace(calm, quat_wxyz=calm.quat_wxyz * norm))
    assert (reason == "") == fine
    assert fine or f"norm {norm:.3f}" in reason


@pytest.mark.parametrize("component", range(4))
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_attitude_that_is_not_finite(make_envelope, calm, component, bad):
    calm.quat_wxyz[component] = bad
    assert "quaternion" in make_envelope().implausible(NOW, calm)


def test_a_robot_without_attitude_is_not_upright(make_envelope, calm):
    calm.quat_wxyz[:] = 0.0
    assert "norm 0.000" in make_envelope().implausible(NOW, calm)
