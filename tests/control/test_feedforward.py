"""What commands carry: by hand-made models and readings, then against a simulated robot."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from g1stream.config import SafetyConfig, SimConfig
from g1stream.control.command import Composer, NextCommand
from g1stream.control.feedforward import FeedForward
from g1stream.control.gains import Gains
from g1stream.control.limits import CommandLimits
from g1stream.control.loop import StreamLoop
from g1stream.control.lowstate import LowStateChecks
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.report import Overruns
from g1stream.control.schedule import Schedule
from g1stream.control.sources import HeldTorques, Moment
from g1stream.control.support import ForceObserver
from g1stream.control.targets import Target, Targets, Timing
from g1stream.dds.messages import LOWSTATE
from g1stream.motion.blend import minimum_jerk
from g1stream.motion.readers import load_motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import InverseDynamics, Solution
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP
from g1stream.sim.lockstep import Lockstep
from g1stream.sim.robot import SimulatedRobot
from g1stream.sim.world import World
from g1stream.types import Phase

NOW = 0.002


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
    return Target.from_point(0.2, trajectory.sample(0.2))


def made(model, kind="dynamics", support="bolted", **other):
    limit = np.full(29, 10.0)
    source = HeldTorques(model, period=0.002) if model else None
    return FeedForward(kind, support, source=source, limit=limit, period=0.002, **other)


def command(feed, target, imu, age=NOW, *, phase=Phase.PLAY, ramped=1.0):
    """What a command carries for a target, with this reading of the IMU."""
    measured = Reading(target.q, target.dq, target.tau, imu)
    return feed.command(Moment(phase, ramped, target, measured, age))


def test_none_asks_for_positions_only(model, target, imu):
    feed = made(model, "none")
    feed.begin("bolted")
    asked = command(feed, target, imu)
    assert not asked.dq.any()
    assert not asked.tau.any()
    assert asked.q.tolist() == target.q.tolist()


def test_velocity_leaves_the_target_as_it_is(model, target, imu):
    feed = made(model, "velocity")
    feed.begin("bolted")
    assert command(feed, target, imu) is target
    assert not model.asked


def test_dynamics_adds_the_torque_of_the_target(model, target, imu):
    feed = made(model)
    feed.begin(None)
    asked = command(feed, target, imu)
    assert asked.tau.tolist() == model.tau.tolist()
    assert asked.dq.tolist() == target.dq.tolist()
    ((support, q, base, force),) = model.asked
    assert support == "bolted"
    assert q.tolist() == target.q.tolist()
    assert base.quat_wxyz.tolist() == [1, 0, 0, 0]
    assert force is None


def test_following_takes_the_base_from_the_reference(model, target, imu):
    feed = made(model, support="follow")
    feed.begin(None)
    command(feed, target, imu)
    base = model.asked[0][2]
    assert base.lin_acc.tolist() == target.root_lin_acc.tolist()
    assert base.ang_vel.tolist() == target.root_ang_vel.tolist()


@pytest.mark.parametrize("elapsed", [0.0, 0.3, 1.0])
def test_the_ramp_blends_the_torque_in(model, target, imu, elapsed):
    feed = made(model)
    feed.begin(None)
    asked = command(feed, target, imu, phase=Phase.RAMP, ramped=elapsed)
    assert asked.tau == pytest.approx(minimum_jerk(2 * elapsed)[0] * model.tau)


def test_torque_is_held_at_its_limit_and_counted(model, target, imu):
    feed = made(model)
    feed.begin(None)
    model.tau[3], model.tau[4] = 11.0, -500.0
    for _ in range(5):
        asked = command(feed, target, imu)
    assert asked.tau[3:5].tolist() == [10.0, -10.0]
    assert feed.saturated.nonzero()[0].tolist() == [3, 4]
    assert feed.saturated[3] == 5


@pytest.mark.parametrize(
    ("kind", "given", "announced", "dynamics", "expected"),
    [
        (None, None, "hanging", True, ("dynamics", "hanging")),
        (None, None, None, True, ("velocity", None)),
        (None, "bolted", None, True, ("dynamics", "bolted")),
        (None, None, "free", True, ("velocity", "free")),
        (None, None, "strapped", True, ("velocity", None)),
        (None, None, "hanging", False, ("velocity", "hanging")),
        ("dynamics", None, "follow", True, ("dynamics", "follow")),
        ("dynamics", None, None, True, ("velocity", None)),
        ("dynamics", "free", "bolted", True, ("dynamics", "free")),
        ("velocity", None, "bolted", True, ("velocity", "bolted")),
        ("none", None, "bolted", True, ("none", "bolted")),
    ],
)
def test_kind_and_support_are_decided_from_what_is_known(
    model, caplog, kind, given, announced, dynamics, expected
):
    feed = made(model if dynamics else None, kind, given)
    feed.begin(announced)
    assert (feed.kind, feed.support) == expected
    wanted = kind == "dynamics" and expected[0] == "velocity"
    contradicted = expected[0] == "dynamics" and given and announced and given != announced
    warned = any(record.levelno == logging.WARNING for record in caplog.records)
    assert warned == bool(wanted or contradicted)


def faulty(imu, **parts):
    return imu._replace(**{name: np.asarray(value, np.float32) for name, value in parts.items()})


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
    model, target, imu, caplog, parts, age, reason
):
    feed = made(model)
    feed.begin(None)
    command(feed, target, imu)
    taus = [command(feed, target, faulty(imu, **parts), age).tau[0] for _ in range(60)]
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


def test_a_short_fault_is_not_reported(model, target, imu):
    feed = made(model)
    feed.begin(None)
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


def test_a_hanging_robot_is_carried_by_the_force_that_its_imu_shows(model, target, imu):
    """Not by its weight: the accelerometer has 2 m/s² more than the model expects."""
    pulled = imu._replace(accelerometer=np.array([0.0, 0.0, 12.0], np.float32))
    feed = made(model, support="hanging")
    feed.begin("hanging")
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


def test_velocities_are_given_in_the_time_of_the_robot(model, target, imu):
    feed = made(model, time_scale=0.8)
    feed.begin(None)
    asked = command(feed, target, imu)
    assert asked.dq == pytest.approx(target.dq / 0.8)
    assert asked.ddq == pytest.approx(target.ddq / 0.64)
    assert asked.q.tolist() == target.q.tolist()


@pytest.mark.parametrize(
    ("announced", "given", "preview"),
    [("bolted", None, 0.002), (None, None, 0.0), (None, 0.01, 0.01)],
)
def test_the_preview_depends_on_the_bridge(model, announced, given, preview):
    feed = made(model, preview=given)
    feed.begin(announced)
    assert feed.preview == preview


def play(robot, support, told, seconds=4.0, *, kind="dynamics", announced=True):
    """Play a piece of the demo in lockstep; gives the RMSE while it played, and the loop."""
    trajectory = Trajectory(load_motion("demo"))
    errors, world = [], World(robot, support)

    def look(topic, data, stamp):
        if topic is LOWSTATE and loop.state.phase is Phase.PLAY:
            played = (link.now() - loop.state.since) / 1e9
            if played >= 0.0:
                errors.append(trajectory.sample(played).joint_pos - world.state().q)

    simulated = SimulatedRobot(world, SimConfig())
    link = Lockstep(simulated, support if announced else None, on_sample=look)
    ns = [round(s * 1e9) for s in (1.0, 1.0, seconds, 0.1, 0.5)]
    feed = FeedForward(
        kind,
        told,
        source=HeldTorques(InverseDynamics(robot), period=0.002),
        limit=robot.effort,
        period=0.002,
        preview=0.002,
    )
    targets = Targets(trajectory, start=0.0)
    schedule = Schedule(targets, Timing(*ns), 2_000_000)
    gains = Gains(EXAMPLE_KP, EXAMPLE_KD)
    composer = Composer(CommandLimits(robot, SafetyConfig()), gains, damp_kd=3.0)
    loop = StreamLoop(
        link,
        link,
        schedule,
        NextCommand(schedule, composer, feed, period=2_000_000),
        LowStateChecks(robot, SafetyConfig(max_tilt=3.0)),
        Overruns(2_000_000, SafetyConfig()),
        period=2_000_000,
    )
    loop.run()
    return float(np.sqrt(np.mean(np.square(errors)))), loop


@pytest.mark.slow
@pytest.mark.parametrize("support", ["bolted", "hanging", "follow"])
def test_the_right_support_follows_ten_times_as_closely_as_none(robot, caplog, support):
    known, loop = play(robot, support, None)
    unknown, _ = play(robot, support, None, kind="velocity")
    assert known < unknown / 10
    assert loop.report.feedforward.support == support
    assert not [record for record in caplog.records if record.levelno == logging.WARNING]


def test_under_the_robots_own_controller_the_measured_attitude_decides(model, target, imu, events):
    tilted = imu._replace(quat_wxyz=np.array([0.8, 0.6, 0, 0], np.float32))
    feed = made(model, None, None, onboard=True)
    feed.begin("follow")
    assert feed.kind == "dynamics"
    assert feed.support is None
    asked = command(feed, target, tilted)
    ((support, _, base, _),) = model.asked
    assert support == "bolted"
    assert base.quat_wxyz == pytest.approx([0.8, 0.6, 0, 0])
    assert asked.tau.tolist() == model.tau.tolist()
    rng = np.random.default_rng(1)
    for tick in range(4000):  # a robot that walks contradicts no support
        walking = imu._replace(gyroscope=rng.normal(size=3).astype(np.float32))
        received = 2_000_000 * tick
        measured = Reading(target.q, target.dq, target.tau, walking, received=received)
        feed.observe(Phase.PLAY, measured)
    assert command(feed, target, tilted).tau.any()
    assert [level for level, _ in events()] == [logging.INFO]


def test_a_robot_under_its_own_controller_sags_without_torque_and_says_so(model, target, events):
    feed = made(model, None, None, onboard=True)
    feed.begin(None)
    assert feed.kind == "velocity"
    assert [level for level, _ in events()] == [logging.WARNING]
