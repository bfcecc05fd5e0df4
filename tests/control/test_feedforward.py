"""What commands carry: by hand-made models and readings, then on a simulated robot."""

import logging

import numpy as np
import pytest

from g1stream.app.rollout import rollout
from g1stream.config import load_config
from g1stream.control.feedforward import FeedForward
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.robot_clock import RobotClock
from g1stream.control.sources import HeldTorques, Moment, Traits
from g1stream.control.support import ForceObserver
from g1stream.control.targets import Setpoint
from g1stream.dds.messages import LowState
from g1stream.motion.blend import minimum_jerk
from g1stream.robot.dynamics import Solution
from g1stream.robot.model import G1, REVISIONS
from g1stream.types import Phase

NOW = 0.002
HELD = Traits()


class Model:
    """Says the same whatever is asked, and remembers what that was."""

    name, mass, gravity = "made", 30.0, 10.0

    def __init__(self):
        self.tau, self.lin_acc, self.ang_acc = np.full(29, 8.0), np.zeros(3), np.zeros(3)
        self.asked = []

    def solve(self, support, q, dq, ddq, base, *, force=None):
        self.asked.append((support, q, base, force))
        return Solution(self.tau, self.lin_acc, self.ang_acc)

    def specific_force(self, solution, base):
        return np.array([0.0, 0.0, 10.0])


@pytest.fixture
def model():
    return Model()


@pytest.fixture
def imu():
    rest = ImuReading(np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0, 0, 10.0]))
    return ImuReading(*(part.astype(np.float32) for part in rest))


@pytest.fixture
def target(trajectory):
    return Setpoint.from_point(0.2, trajectory.sample(0.2))


@pytest.fixture
def made(model, target, monkeypatch):
    """A feed-forward in RAMP, of a bridge that has announced its support or has not."""
    monkeypatch.setattr("g1stream.control.sources.InverseDynamics", lambda robot: model)

    def make(announced=None, *, kind="dynamics", support="bolted", traits=HELD, **other):
        config = load_config(over={"stream.feedforward": kind, "stream.support": support})
        source = HeldTorques(config, G1.load(REVISIONS[1]), simulated=True)
        source.traits = traits
        feed = FeedForward(source, limit=np.full(29, 10.0), period=0.002, **other)
        feed.begin(target, announced)
        return feed

    return make


def command(feed, target, imu, age=NOW, *, phase=Phase.PLAY, ramped=1.0, arrived=0):
    """What a command carries for a target, with this reading of the IMU."""
    measured = Reading(target.q, target.dq, target.tau, imu, arrived=arrived)
    return feed.command(Moment(phase, ramped, target, measured, age))


def test_none_asks_for_positions_only(made, target, imu):
    asked = command(made("bolted", kind="none"), target, imu)
    assert not asked.dq.any()
    assert not asked.tau.any()
    assert asked.q.tolist() == target.q.tolist()


def test_velocity_leaves_the_target_as_it_is(made, model, target, imu):
    assert command(made("bolted", kind="velocity"), target, imu) is target
    assert not model.asked


def test_dynamics_adds_the_torque_of_the_target(made, model, target, imu):
    asked = command(made(), target, imu)
    assert asked.tau.tolist() == model.tau.tolist()
    assert asked.dq.tolist() == target.dq.tolist()
    ((support, q, base, force),) = model.asked
    assert support == "bolted"
    assert q.tolist() == target.q.tolist()
    assert base.quat_wxyz.tolist() == [1, 0, 0, 0]
    assert force is None


def test_a_rate_that_one_state_alone_has_is_not_the_bases(made, model, target):
    state, measured = LowState(), None
    state.quaternion[:] = 1, 0, 0, 0
    for rate in (0.1, 0.2, 9.9):
        state.gyroscope[:] = rate
        measured = Reading.from_low_state(state, 0, measured)
    made().command(Moment(Phase.PLAY, 1.0, target, measured, NOW))
    ((_, _, base, _),) = model.asked
    assert base.ang_vel.tolist() == pytest.approx([0.2] * 3)


def test_following_takes_the_base_from_the_reference(made, model, target, imu):
    command(made(support="follow"), target, imu)
    base = model.asked[0][2]
    assert base.lin_acc.tolist() == target.root_lin_acc.tolist()
    assert base.ang_vel.tolist() == target.root_ang_vel.tolist()


@pytest.mark.parametrize("elapsed", [0.0, 0.3, 1.0])
def test_the_ramp_blends_the_torque_in(made, model, target, imu, elapsed):
    asked = command(made(), target, imu, phase=Phase.RAMP, ramped=elapsed)
    assert asked.tau == pytest.approx(minimum_jerk(2 * elapsed)[0] * model.tau)


def test_torque_is_held_at_its_limit_and_counted(made, model, target, imu):
    feed = made()
    model.tau[3], model.tau[4] = 11.0, -500.0
    for _ in range(5):
        asked = command(feed, target, imu)
    assert asked.tau[3:5].tolist() == [10.0, -10.0]
    assert feed.saturated.nonzero()[0].tolist() == [3, 4]
    assert feed.saturated[3] == 5


@pytest.mark.parametrize(
    ("kind", "given", "announced", "expected"),
    [
        (None, None, "hanging", ("dynamics", "hanging")),
        (None, None, None, ("velocity", None)),
        (None, "bolted", None, ("dynamics", "bolted")),
        (None, None, "free", ("velocity", "free")),
        (None, None, "strapped", ("velocity", None)),
        ("dynamics", None, "follow", ("dynamics", "follow")),
        ("dynamics", None, None, ("velocity", None)),
        ("dynamics", "free", "bolted", ("dynamics", "free")),
        ("velocity", None, "bolted", ("velocity", "bolted")),
    ],
)
def test_kind_and_support_are_decided_from_what_is_known(
    made, caplog, kind, given, announced, expected
):
    feed = made(announced, kind=kind, support=given)
    assert (feed.mode.kind, feed.mode.support) == expected
    wanted = kind == "dynamics" and expected[0] == "velocity"
    contradicted = expected[0] == "dynamics" and given and announced and given != announced
    warned = any(record.levelno == logging.WARNING for record in caplog.records)
    assert warned == bool(wanted or contradicted)


@pytest.mark.parametrize(
    ("parts", "age", "reason"),
    [
        ({}, 0.05, "older"),
        ({"gyroscope": [0, np.nan, 0]}, NOW, "NaN"),
        ({"accelerometer": [np.inf, 0, 0]}, NOW, "NaN"),
        ({"quat_wxyz": [0, 0, 0, 0]}, NOW, "norm 1"),
        ({"gyroscope": [0, 0, 100.0]}, NOW, "gyroscope"),
    ],
)
def test_a_bad_imu_fades_the_torque_out_and_is_logged(
    made, target, imu, caplog, parts, age, reason
):
    feed = made()
    command(feed, target, imu)
    faulty = imu._replace(**{name: np.array(value, np.float32) for name, value in parts.items()})
    taus = [command(feed, target, faulty, age).tau[0] for _ in range(60)]
    assert np.diff([8.0, *taus]).min() >= -8.0 * 0.002 / 0.1 - 1e-9
    assert taus[-1] == 0.0
    (change,) = feed.changes
    assert change.kind == "velocity"
    assert reason in change.reason
    back = [command(feed, target, imu).tau[0] for _ in range(60)]
    assert back[-1] == 8.0
    assert [one.kind for one in feed.changes] == ["velocity", "dynamics"]
    warnings = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert [record.args for record in warnings] == [(change.reason,), ()]


def test_a_short_fault_is_not_reported(made, target, imu):
    feed = made()
    for age in [NOW] * 5 + [0.05] * 5 + [NOW] * 60:
        asked = command(feed, target, imu, age)
    assert asked.tau[0] == 8.0
    assert not feed.changes


def test_the_observer_finds_a_force_that_is_not_the_weight(model):
    """A body of 30 kg that is pushed by 12, -5, 20 N more than its weight, for half a second."""
    observer = ForceObserver(model, 0.002)
    quat = np.array([np.cos(0.4), 0.0, np.sin(0.4), 0.0])
    turn = np.array([[np.cos(0.8), 0, np.sin(0.8)], [0, 1, 0], [-np.sin(0.8), 0, np.cos(0.8)]])
    push = np.array([12.0, -5.0, 20.0])
    reading = turn.T @ (push / 30.0 + [0, 0, 10.0])
    imu = ImuReading(quat, np.zeros(3), reading)
    weight = np.array([0.0, 0.0, 300.0])
    force = observer.update(imu)
    assert force.tolist() == weight.tolist()
    for _ in range(250):
        felt = turn.T @ force / 30.0
        observer.expect(felt)
        force = observer.update(imu)
    assert force - weight == pytest.approx(push, abs=0.01)


def test_a_hanging_robot_is_carried_by_the_force_that_its_imu_shows(made, model, target, imu):
    """Not by its weight: the accelerometer has 2 m/s² more than the model expects."""
    pulled = imu._replace(accelerometer=np.array([0.0, 0.0, 12.0], np.float32))
    feed = made("hanging", support="hanging")
    for _ in range(500):
        command(feed, target, pulled)
    forces = [force for _, _, _, force in model.asked]
    assert forces[0].tolist() == [0.0, 0.0, 300.0]
    assert forces[-1][2] > 350.0


def test_the_observer_is_bounded(model):
    observer = ForceObserver(model, 0.002)
    imu = ImuReading(np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([1000.0, 0, 10.0]))
    for _ in range(100):
        observer.expect(np.array([0.0, 0.0, 10.0]))
        force = observer.update(imu)
    assert np.linalg.norm(force - [0, 0, 300.0]) == pytest.approx(300.0)


def test_velocities_are_given_in_the_time_of_the_robot(made, target, imu):
    asked = command(made(robot_clock=RobotClock(0.8)), target, imu)
    assert asked.dq == pytest.approx(target.dq / 0.8)
    assert asked.ddq == pytest.approx(target.ddq / 0.64)
    assert asked.q.tolist() == target.q.tolist()


@pytest.mark.parametrize(
    ("announced", "given", "preview"),
    [("bolted", None, 0.002), (None, None, 0.0), (None, 0.01, 0.01)],
)
def test_the_preview_depends_on_the_bridge(made, announced, given, preview):
    assert made(announced, preview=given).preview == preview


def test_what_a_policy_observes_is_the_reference_of_a_tick(made):
    feed = made(None, preview=0.0031, traits=Traits(makes_targets=True))
    assert feed.preview == pytest.approx(0.004)


@pytest.mark.slow
@pytest.mark.parametrize("support", ["hanging", "follow"])
def test_the_right_support_follows_ten_times_as_closely_as_none(support):
    over = {"record.channels": "raw", "stream.ramp": 1.0, "stream.hold": 0.0, "stream.damp": 0.5}
    config = load_config(over=over)
    known, unknown = (
        rollout("demo", support=support, feedforward=kind, config=config, seconds=2.0).summary()
        for kind in ("dynamics", "velocity")
    )
    assert known.tracking.all_joints.rmse_rad < unknown.tracking.all_joints.rmse_rad / 10
    assert known.stream.support == support
    assert known.stream.feedforward_changes == []
