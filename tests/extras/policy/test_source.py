from dataclasses import replace

import numpy as np
import onnx
import pytest

import g1stream
from g1stream.app.sim import make_world
from g1stream.cli.main import main
from g1stream.config import load_config
from g1stream.control.combinations import require_combination
from g1stream.control.loop import make_loop
from g1stream.control.plan import plan
from g1stream.control.reading import ImuReading, Reading
from g1stream.control.sources import Moment
from g1stream.control.targets import Setpoint
from g1stream.dds.messages import REFERENCE, Samples, SportModeState
from g1stream.errors import ConfigError, SafetyError
from g1stream.extras.policy.contract import read_contract
from g1stream.extras.policy.feet_load import FeetLoad
from g1stream.extras.policy.network import Network
from g1stream.extras.policy.odometry import Odometry
from g1stream.extras.policy.source import BackToStanding, PolicyTargets
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.dynamics import BaseMotion, InverseDynamics
from g1stream.robot.model import G1
from g1stream.robot.rotations import quat_from_rpy, quat_mul, tilt_of, yaw_of
from g1stream.robot.soles import Soles
from g1stream.sim.lockstep import Lockstep
from g1stream.sim.robot import SimulatedRobot
from g1stream.types import Phase
from known_policies import DANCE, POLICIES, needs_policies, saved

ROBOT = G1.default()
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def settings(path, **stream):
    return load_config(
        over={"stream.policy": str(path)} | {f"stream.{k}": v for k, v in stream.items()}
    )


def moving(seconds=2.0, fps=50.0):
    """Arms that swing, above the floor, with a heading and a place of its own."""
    times = np.arange(round(seconds * fps) + 1) / fps
    joint_pos = np.zeros((len(times), 29))
    joint_pos[:, 15] = 0.3 * np.sin(2.0 * np.pi * times)
    return Motion(
        name="swing",
        fps=fps,
        joint_pos=joint_pos,
        root_pos=np.tile([1.0, 2.0, 0.8], (len(times), 1)),
        root_quat_wxyz=np.tile(quat_from_rpy(np.array([0.0, 0.0, 1.0])), (len(times), 1)),
    )


@pytest.fixture
def target():
    return Setpoint.from_point(0.0, Trajectory(moving()).sample(0.0))


class Driven:
    """A source whose commands are asked for every 2 ms of its time."""

    def __init__(self, source, target):
        self.source, self.target = source, target
        self.time, self.took = 5.0, 0.0
        self.quat, self.gyroscope = target.root_quat_wxyz, np.zeros(3)
        source.begin(target, "free", None)

    def command(self, phase=Phase.PLAY, passed=0.002, arrived=None):
        imu = ImuReading(self.quat, self.gyroscope, np.array([0.0, 0.0, 9.81]))
        arrived = round(1e9 * self.time) if arrived is None else arrived
        measured = Reading(self.target.q, np.zeros(29), np.zeros(29), imu, arrived=arrived)
        clock = iter([0, 0, round(1e9 * self.took)]).__next__
        asked = self.source.command(
            Moment(phase, 1.0, self.target, measured, 0.0, self.time, 0, clock)
        )
        self.time += passed
        return asked

    def steps(self, n, **about):
        """How many of the next n commands the policy has computed anew."""
        told = 0
        for _ in range(n):
            self.command(**about)
            told += bool(self.source.status.step)
        return told


@pytest.fixture
def driven(policy, target):
    return Driven(PolicyTargets(settings(policy()), ROBOT), target)


def test_a_policy_computes_at_its_own_rate(driven):
    assert driven.steps(5, phase=Phase.RAMP) == 0
    assert driven.steps(1) == 1
    assert driven.steps(9) == 0
    assert driven.steps(1) == 1
    assert driven.steps(989) == 98


def test_in_ramp_the_target_is_that_of_the_motion(driven, target):
    assert driven.command(Phase.RAMP) is target
    asked = driven.command()
    assert not np.allclose(asked.q, target.q)
    assert not asked.dq.any()
    assert not asked.tau.any()


def test_a_policy_waits_while_the_motion_waits(driven):
    assert driven.steps(1) == 1
    assert driven.steps(50, passed=0.0) == 0
    driven.time += 0.1  # it catches up: five steps are left out
    assert driven.steps(1) == 1
    assert driven.steps(9) == 0


def test_a_policy_holds_its_target_until_a_new_state_arrives(driven):
    held = driven.command(arrived=1).q
    assert driven.steps(100, arrived=1) == 0
    assert np.array_equal(driven.command(arrived=1).q, held)
    assert driven.steps(10, arrived=2) == 1
    assert driven.steps(10) == 1


def test_targets_are_of_the_contract(driven, policy):
    """The weights are alike, so that each action is the sum of the observation."""
    asked, target = driven.command(), driven.target
    orientation = 2.0  # the first two columns of the unit matrix
    action = 0.01 * (target.q.sum() + target.dq.sum() + orientation + (target.q - 0.1).sum())
    assert asked.q == pytest.approx(0.1 + 0.5 * action, abs=1e-6)
    assert driven.source.traits.gains.kp == pytest.approx(np.full(29, 40.0))
    assert driven.source.traits.gains.kd == pytest.approx(np.full(29, 2.0))


@pytest.mark.parametrize(("start", "before"), [("first step", 1.0), ("zeros", 0.0)])
def test_a_history_has_the_oldest_step_first(policy, target, start, before):
    path = policy({"observation_history_lengths": "1,1,3,1,1,2"}, width=154 + 2 * 3 + 29)
    path.with_suffix(".toml").write_text(f'history_start = "{start}"\n')
    it = Driven(PolicyTargets(settings(path), ROBOT), target)
    seen, acted = [], np.zeros(29)
    for speed in (1.0, 2.0, 3.0, 4.0):
        it.gyroscope = np.full(3, speed)
        assert it.steps(10) == 1
        told = it.source._newest
        assert told.n_observation[()] == 154 + 2 * 3 + 29
        seen.append(told.observation[64:73].reshape(3, 3)[:, 0].tolist())
        np.testing.assert_array_equal(told.observation[160:189], acted)
        acted = told.action.copy()
    assert seen == [[before, before, 1.0], [before, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]


def test_what_is_not_finite_is_repeated_twice(policy, target, tmp_path):
    """The square root of a negative sum."""
    model = onnx.load(policy())
    model.graph.node[0].output[0] = "sum"
    model.graph.node.append(onnx.helper.make_node("Sqrt", ["sum"], ["actions"]))
    onnx.save(model, path := tmp_path / "root.onnx")
    it = Driven(PolicyTargets(settings(path), ROBOT), target)
    it.gyroscope = np.full(3, 10.0)
    finite = it.command().q
    it.gyroscope = np.full(3, -10.0)
    for _ in range(29):
        assert np.array_equal(it.command().q, finite)
    assert not it.source.status.fall
    it.command()
    assert "finite" in it.source.status.fall
    assert np.array_equal(it.command().q, finite)


def test_one_that_takes_longer_than_a_step_may_do_so_twice(driven):
    driven.took = 0.03
    driven.steps(11)
    assert not driven.source.status.fall
    driven.took = 0.01
    driven.steps(10)
    driven.took = 0.03
    driven.steps(20)
    assert not driven.source.status.fall
    driven.steps(10)
    assert "20 ms, the last one 30" in driven.source.status.fall


@pytest.mark.parametrize(("tilt", "falls"), [(0.5, False), (0.7, True)])
def test_a_robot_falls_by_its_tilt_against_the_reference(driven, tilt, falls):
    leaning = quat_mul(driven.target.root_quat_wxyz, quat_from_rpy(np.array([0.0, 0.9, 0.0])))
    driven.target = driven.target._replace(root_quat_wxyz=leaning)
    driven.quat = quat_mul(leaning, quat_from_rpy(np.array([0.0, tilt, 0.0])))
    driven.command()
    assert bool(driven.source.status.fall) == falls


@pytest.mark.parametrize(
    ("stand", "time", "told"),
    [
        (3.0, 2.8, (True, True)),
        (3.0, 4.3, (True, True)),  # 0.3 s after the motion has begun
        (3.0, 5.0, (False, False)),
        (3.0, 7.5, (True, True)),  # after it
        (3.0, 0.3, (True, False)),  # so early that it would not stand for a shorter time either
        (0.5, 0.4, (True, False)),
        (0.5, 2.5, (False, False)),
    ],
)
def test_a_fall_while_the_robot_stands_says_so_and_to_stand_shorter(policy, stand, time, told):
    """The motion begins a second after the standing and takes 2 s."""
    source = PolicyTargets(settings(policy(), stand=stand), ROBOT)
    trajectory = Trajectory(source.prepare(moving(2.0)).motion)
    it = Driven(source, Setpoint.from_point(time, trajectory.sample(time)))
    it.quat = quat_mul(it.quat, quat_from_rpy(np.array([0.0, 0.7, 0.0])))
    it.command()
    fall = source.status.fall
    assert ("stands" in fall, "--stand" in fall) == told


def test_a_motion_begins_and_ends_with_the_still_pose(policy):
    path = policy()
    source = PolicyTargets(settings(path, stand=2.0), ROBOT)
    motion = source.prepare(moving(2.0)).motion
    still = np.full(29, 0.1)
    assert motion.duration == pytest.approx(2.0 + 1.0 + 2.0 + 1.0, abs=0.05)
    at = Trajectory(motion).sample
    for time in (0.0, 1.0, 2.0, motion.duration):
        assert at(time).joint_pos == pytest.approx(still, abs=1e-9)
    assert motion.joint_pos[150:251] == pytest.approx(moving(2.0).joint_pos)
    soles = Soles(ROBOT).path(motion.joint_pos[:1], motion.root_pos[:1], motion.root_quat_wxyz[:1])
    assert soles[..., 2].min() == pytest.approx(0.0, abs=1e-3)
    assert yaw_of(motion.root_quat_wxyz) == pytest.approx(np.full(motion.n_frames, 1.0))
    assert source.traits.makes_targets


def test_between_motions_that_wait_it_stands(policy):
    source = PolicyTargets(settings(policy(), stand=2.0, wait_for="enter"), ROBOT)
    motion, _, rests = source.prepare(moving(2.0).then(moving(1.0).mirrored(), 0.5))
    assert motion.duration == pytest.approx(2.0 + (1 + 2.0 + 1) + (2.0 + 1 + 1.0 + 1), abs=0.1)
    assert rests == pytest.approx((2.0 + 1 + 2.0 + 1 + 2.0 - 0.1,), abs=0.05)
    at = Trajectory(motion).sample
    for time in np.linspace(rests[0] - 1.8, rests[0] + 0.05, 7):
        assert at(time).joint_pos == pytest.approx(np.full(29, 0.1), abs=1e-9)
        assert at(time).joint_vel == pytest.approx(np.zeros(29), abs=1e-6)
    assert motion.joint_pos[-102:-51] == pytest.approx(moving(1.0).mirrored().joint_pos)


@pytest.mark.parametrize("wait_for", [None, "enter"])
def test_each_motion_has_its_own_phase(policy, wait_for):
    source = PolicyTargets(settings(policy(), stand=2.0, wait_for=wait_for), ROBOT)
    motion = source.prepare(moving(2.0).then(moving(1.0).mirrored(), 0.5)).motion
    phases, second = [], 3.0 + 2.0 + (4.0 if wait_for else 0.5)
    for time in (0.5, 3.0, 4.0, 5.0, second - 0.1, second, second + 0.5, second + 1.0):
        target = Setpoint.from_point(time, Trajectory(motion).sample(time))
        phases.append(source._reference(target).phase)
    assert phases == pytest.approx([0, 0, 0.5, 1, 1, 0, 0.5, 1], abs=0.03)


def test_a_part_within_a_blend_is_one_motion(policy):
    given = settings(policy(), stand=1.0, start=2.1, duration=0.3, wait_for="enter")
    changed = PolicyTargets(given, ROBOT).prepare(moving(2.0).then(moving(2.0), 0.5))
    assert changed.rests == ()
    assert changed.motion.duration == pytest.approx(1.0 + 1.0 + 0.3 + 1.0, abs=0.05)


@needs_policies
def test_a_policy_stands_while_the_next_motion_waits_and_then_plays_it():
    policy = POLICIES / "holosoma_dance1_subject2.onnx"
    dance = g1stream.load_motion(policy).trim(0.0, 2.0)
    config = settings(policy, wait_for="A", stand=1.0, feedforward="dynamics", support="free")
    config = config.model_copy(update={"sim": config.sim.model_copy(update={"support": "free"})})
    planned = plan(dance.then(dance), config, simulated=True)
    assert len(planned.rests) == 1
    sent = []

    def press(state):
        resting = len(sent) > 4000 and sent[-1] == sent[-4000]  # for 8 s
        state.wireless_remote[3] = resting

    robot = SimulatedRobot(make_world(ROBOT, config.sim), config.sim, mode_machine=5, noise=press)

    def on_sample(topic, data, stamp):
        if topic is REFERENCE:
            sent.append(Samples(REFERENCE, [data])["motion_time"][0])

    link = Lockstep(robot, "free", on_sample=on_sample)
    report = make_loop(planned, link, link, settle=0).run()
    assert report.stop is None
    values, counts = np.unique(np.round(sent, 6), return_counts=True)
    assert counts[np.argmin(np.abs(values - planned.rests[0]))] == pytest.approx(4000, abs=5)
    assert report.played / 1e9 == pytest.approx(planned.motion.duration, abs=0.01)


def test_a_part_of_a_motion(policy):
    source = PolicyTargets(settings(policy(), stand=1.0, start=0.5, duration=0.8), ROBOT)
    motion = source.prepare(moving(2.0)).motion
    assert motion.joint_pos[100:141] == pytest.approx(moving(2.0).joint_pos[25:66])
    assert motion.duration == pytest.approx(1.0 + 1.0 + 0.8 + 1.0, abs=0.05)


def test_the_way_back_to_standing(policy, target):
    source = PolicyTargets(settings(policy(), stand=2.0), ROBOT)
    down = source.traits.way_down
    assert isinstance(down, BackToStanding)
    assert down.length == 3.0
    leaning = quat_mul(target.root_quat_wxyz, quat_from_rpy(np.array([0.2, 0.3, 0.0])))
    start = target._replace(root_quat_wxyz=leaning, q=np.linspace(-0.2, 0.2, 29)).at_rest()
    assert down.possible(start)
    at = down.plan(start)
    begin, end = at(0.0, start.q), at(3.0, start.q)
    assert begin.q == pytest.approx(start.q)
    assert begin.root_quat_wxyz == pytest.approx(start.root_quat_wxyz)
    assert end.q == pytest.approx(np.full(29, 0.1))
    assert tilt_of(end.root_quat_wxyz) == pytest.approx(0.0, abs=1e-6)
    assert yaw_of(end.root_quat_wxyz) == pytest.approx(yaw_of(leaning))
    assert not np.concatenate([end.dq, end.ddq, end.root_lin_vel, end.root_ang_vel]).any()
    step = 1e-4
    for time in (0.2, 0.5, 0.9):
        before, now, after = (at(time + shift, start.q) for shift in (-step, 0.0, step))
        assert now.dq == pytest.approx((after.q - before.q) / (2 * step), abs=1e-4)
        assert now.ddq == pytest.approx((after.dq - before.dq) / (2 * step), abs=1e-3)
        speed = (after.root_pos - before.root_pos) / (2 * step)
        assert now.root_lin_vel == pytest.approx(speed, abs=1e-4)


@pytest.mark.parametrize(
    "over",
    [
        {"stream.loop": True, "stream.duration": 2.0},
        {"stream.joints": "arms"},
        {"stream.via": "arm_sdk"},
        {"stream.support": "hanging"},
        {"stream.feedforward": "velocity"},
        {"gains.kp": {"*": 20.0}},
    ],
)
def test_settings_that_do_not_go_with_a_policy(policy, over):
    config = load_config(over={"stream.policy": str(policy())} | over)
    with pytest.raises(ConfigError):
        require_combination(config, ROBOT, simulated=True)


def test_the_rate_is_a_multiple_of_the_policys(policy):
    with pytest.raises(ConfigError):
        PolicyTargets(
            load_config(over={"stream.policy": str(policy()), "stream.rate": 120.0}), ROBOT
        )


def test_no_robot_and_none_that_a_simulator_holds_is_commanded_by_a_policy(policy, target):
    require_combination(settings(policy()), ROBOT, simulated=True)
    with pytest.raises(SafetyError):
        require_combination(settings(policy()), ROBOT, simulated=False)
    with pytest.raises(ConfigError, match="g1_23dof"):
        require_combination(settings(policy()), G1.load("g1_23dof"), simulated=True)
    with pytest.raises(ConfigError):
        PolicyTargets(settings(policy()), ROBOT).begin(target, "bolted", None)


def bent(angle=0.3):
    pose = np.zeros(29)
    pose[[0, 6]], pose[[3, 9]], pose[[4, 10]] = -angle, 2 * angle, -angle
    return pose


def hanging_torque(dynamics):
    still = np.zeros(29)
    return dynamics.solve("bolted", bent(), still, still, BaseMotion(UPRIGHT, np.zeros(3))).tau


def weighed(tau):
    imu = ImuReading(UPRIGHT, np.zeros(3), np.array([0, 0, 9.81]))
    return Reading(bent(), np.zeros(29), tau, imu)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_the_share_of_the_weight_on_the_feet(share):
    """Torques by virtual work: the feet push with a share of the weight, half on each."""
    dynamics, soles = InverseDynamics(ROBOT), Soles(ROBOT)
    push = 0.5 * share * dynamics.mass * dynamics.gravity
    tau = hanging_torque(dynamics)
    for joint in range(12):
        turned = np.repeat(bent()[None], 2, axis=0)
        turned[:, joint] += [-1e-3, 1e-3]
        corners = soles.path(turned, np.zeros((2, 3)), np.repeat(UPRIGHT[None], 2, axis=0))
        tau[joint] -= push * (corners[1] - corners[0])[:, 2].sum() / 4 / 2e-3
    assert FeetLoad(ROBOT).share(weighed(tau)) == pytest.approx(share, abs=0.01)


def test_ramp_waits_for_the_feet_where_the_bridge_does_not_lower_the_robot(policy, target):
    source = PolicyTargets(settings(policy()), ROBOT)
    source.begin(target, None, None)
    hanging = hanging_torque(InverseDynamics(ROBOT))
    standing = hanging.copy()
    standing[[3, 9]] -= 20.0  # the knees carry it
    for tau, waits in ((hanging, True), (standing, False)):
        for i in range(40):
            measured = weighed(tau)
            arrived = round(1e9 * (10.0 + 0.02 * i + 5.0 * (not waits)))
            object.__setattr__(measured, "arrived", arrived)
            source.command(Moment(Phase.RAMP, 1.0, target, measured, 0.0))
        assert bool(source.status.awaited) == waits
    source = PolicyTargets(settings(policy()), ROBOT)
    source.begin(target, "free", None)
    assert not source.status.awaited


def test_leg_odometry_of_a_robot_that_shifts_over_its_feet():
    """The soles stand; the pelvis moves by the joints that the standing soles ask for."""
    odometry = Odometry(ROBOT)
    corners = Soles(ROBOT)
    height = 0.0
    for i in range(51):
        pose = bent(0.3 + 0.006 * i)
        odometry.update(pose, UPRIGHT, 0.02)
        soles = corners.path(pose[None], np.zeros((1, 3)), UPRIGHT[None])
        before, height = height, -float(soles[..., 2].min())
    assert odometry.pos[2] == pytest.approx(height, abs=1e-6)
    assert odometry.vel[2] == pytest.approx((height - before) / 0.02, abs=1e-6)
    assert np.abs(odometry.pos[:2]).max() < 0.01


def published(position, velocity, yaw=0.0):
    message = SportModeState()
    message.position[:], message.velocity[:] = position, velocity
    message.quaternion[:] = quat_from_rpy(np.array([0.0, 0.0, yaw]))
    return message.tobytes()


def test_place_and_velocity_of_the_robot_come_before_leg_odometry():
    """The robot stands still on its legs, but says that it slides, in a world with its own yaw."""
    odometry, quat = Odometry(ROBOT), quat_from_rpy(np.array([0.0, 0.0, 0.5]))
    said = [
        published([7.0 + 0.1 * i, 3.0, 9.0], [5.0, 0.0, 0.0], yaw=0.5 - np.pi / 2)
        for i in (0, 1, 2)
    ]
    odometry.newest = iter([*said[:2], None, said[2], None]).__next__
    found = []
    for _ in range(5):
        odometry.update(bent(), quat, 0.02)
        found.append((odometry.pos.copy(), odometry.vel.copy()))
    # Its x axis is the y axis of the IMU's world. A gap has the legs' movement: none.
    height = found[0][0][2]
    assert [pos for pos, _ in found] == [
        pytest.approx([0.0, y, height], abs=1e-6) for y in (0.0, 0.1, 0.1, 0.1, 0.1)
    ]
    speeds = [5.0, 5.0, 0.0, 5.0, 0.0]
    assert [vel for _, vel in found] == [pytest.approx([0.0, v, 0.0], abs=1e-6) for v in speeds]
    assert 0.6 < height < 0.8


def test_a_yaw_that_drifts_moves_no_place():
    """The robot stands 20 m from its origin, while its own yaw drifts."""
    odometry = Odometry(ROBOT)
    said = [published([20.0, 0.0, 0.8], np.zeros(3), yaw=0.01 * i) for i in range(20)]
    odometry.newest = iter(said).__next__
    for _ in said:
        odometry.update(bent(), UPRIGHT, 0.02)
    assert odometry.pos[:2] == pytest.approx([0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("field", ["position", "velocity", "quaternion"])
def test_a_place_that_is_not_finite_is_ignored(field):
    odometry, damaged = Odometry(ROBOT), SportModeState()
    damaged.load(published([0.1, 0.0, 0.8], np.zeros(3)))
    getattr(damaged, field)[1] = np.nan
    said = [published([x, 0.0, 0.8], [0.5, 0.0, 0.0]) for x in (0.0, 0.2, 0.3)]
    odometry.newest = iter([said[0], damaged.tobytes(), *said[1:]]).__next__
    for _ in range(4):
        odometry.update(bent(), UPRIGHT, 0.02)
    assert odometry.pos[:2] == pytest.approx([0.1, 0.0], abs=1e-6)  # since the sample after it
    assert odometry.vel == pytest.approx([0.5, 0.0, 0.0])


def test_the_doubts_are_those_of_the_robot(policy, target, caplog):
    weak = replace(ROBOT, effort=0.1 * ROBOT.effort)
    source = PolicyTargets(settings(policy()), weak)
    source.begin(target, "free", None)
    doubts = source.contract.doubts(weak)
    assert doubts != source.contract.doubts(ROBOT)
    assert [one for one in doubts if one in caplog.text] == doubts


def test_a_policy_subscribes_to_the_place_only_if_it_observes_it(policy, target):
    asked = []

    def subscribe(topic):
        asked.append(topic.name)
        return lambda: published([0.0, 0.0, 0.8], [0.3, 0.0, 0.0])

    PolicyTargets(settings(policy()), ROBOT).listen(subscribe)
    assert asked == []
    names = "command,motion_anchor_ori_b,base_ang_vel,joint_pos,joint_vel,actions,base_lin_vel"
    source = PolicyTargets(settings(policy({"observation_names": names}, width=157)), ROBOT)
    source.listen(subscribe)
    assert asked == ["rt/odommodestate"]
    it = Driven(source, target)
    it.command()
    assert source._newest.observation[154:157] == pytest.approx([0.3, 0.0, 0.0], abs=1e-6)


@needs_policies
def test_a_policy_that_holds_its_motion_is_a_motion_file():
    motion = g1stream.load_motion(POLICIES / "holosoma_dance1_subject2.onnx")
    dance = g1stream.load_motion(DANCE)
    assert (motion.fps, motion.n_frames) == (50.0, 6574)
    assert motion.duration == pytest.approx(dance.duration, abs=0.02)
    both = motion.resample(30.0)
    n = min(both.n_frames, dance.n_frames)
    assert np.sqrt(np.mean((both.joint_pos[:n] - dance.joint_pos[:n]) ** 2)) < 0.02
    assert np.abs(both.root_pos[:n] - dance.root_pos[:n]).max() < 0.02


@needs_policies
def test_a_policy_that_asks_for_the_base_walks_with_leg_odometry():
    path = POLICIES / "beyondmimic_29dof.onnx"
    config = load_config(
        over={"stream.stand": 0.5, "stream.duration": 3.0, "stream.ramp": 1.0, "stream.hold": 0.0}
    )
    motion = g1stream.load_motion(path)
    assert [text for text in motion.warnings if "frame rate: 50 fps, assumed" in text]
    assert not g1stream.load_motion(path, fps=50.0).warnings
    session = g1stream.rollout(motion, config=config, policy=path)
    terms = read_contract(Network(path), ROBOT).terms
    assert {"base_lin_vel", "motion_anchor_pos_b"} <= {term.name for term in terms}
    playing = next(phase for phase in session.phases if phase.phase is Phase.PLAY)
    walked = (session.base.time > playing.start_s) & (session.base.time < playing.start_s + 4.0)
    assert session.base.position[walked, 2].min() > 0.6
    assert np.ptp(session.base.position[walked, 0]) > 1.0


@needs_policies
def test_a_scale_in_the_metadata_of_mjlab_is_applied(tmp_path):
    """A network that multiplies the gyroscope by 4, behind a scale of 1/4, is the same policy."""
    source, path = POLICIES / "beyondmimic_29dof.onnx", tmp_path / "scaled.onnx"
    model = onnx.load(source)
    told = {one.key: one.value for one in model.metadata_props}
    names = told["observation_names"].split(",")
    terms = read_contract(Network(source), ROBOT).terms
    at, size = names.index("base_ang_vel"), 3
    factor = np.ones((1, 160), np.float32)
    begin = sum(term.size for term in terms[:at])
    factor[0, begin : begin + size] = 4.0
    model.graph.initializer.append(onnx.numpy_helper.from_array(factor, "factor"))
    for node in model.graph.node:
        node.input[:] = ["unscaled" if one == "obs" else one for one in node.input]
    model.graph.node.insert(0, onnx.helper.make_node("Mul", ["obs", "factor"], ["unscaled"]))
    del told["observation_history_lengths"]
    told |= {
        "observation_terms_scale": ",".join("0.250" if i == at else "1.000" for i in range(8)),
        "observation_terms_clip": ",".join(["-inf;inf"] * 8),
        "observation_terms_history_length": ",".join(["0.000"] * 8),
    }
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, told)
    onnx.save(model, path)
    played = [g1stream.rollout(policy=one, seconds=2.0) for one in (source, path)]
    np.testing.assert_array_equal(played[0].measured.q, played[1].measured.q)
    np.testing.assert_array_equal(played[0].policy.action, played[1].policy.action)
    assert len(played[0].policy) > 100


@pytest.mark.parametrize(("start", "duration"), [(0.0, None), (2.0, 5.0)])
def test_the_phase_is_that_of_the_whole_motion_without_the_standing(
    tmp_path, target, start, duration
):
    """PBHC observes the share of its motion that has passed; the bundled motion takes 14 s."""
    path = saved(tmp_path / "policy.onnx", [("actor_obs", 380)], [("action", 23)])
    path.with_suffix(".toml").write_text('family = "pbhc"')
    stream = {"policy": str(path), "stand": 0.5, "beyond_limits": "anyway"}
    part = {"start": start} | ({"duration": duration} if duration else {})
    source = PolicyTargets(load_config(over={"stream": stream | part}), ROBOT)
    changed = source.prepare(g1stream.load_motion("demo")).motion
    length = duration or 14.0
    assert changed.duration == pytest.approx(0.5 + 1.0 + length + 1.0, abs=0.1)
    times = np.array([0.0, 1.5, 1.5 + 0.25 * length, 1.5 + length, changed.duration])
    phases = [source._reference(target._replace(motion_time=one)).phase for one in times]
    passed = start + length * np.array([0.0, 0.0, 0.25, 1.0, 1.0])
    assert phases == pytest.approx(passed / 14.0, abs=1e-6)


@needs_policies
def test_a_motion_that_is_played_without_its_network_says_so(capsys):
    file = str(POLICIES / "holosoma_dance1_subject2.onnx")
    assert main(["stream", file]) == 2  # joints are too fast
    assert f"--policy {file}" in capsys.readouterr().err
