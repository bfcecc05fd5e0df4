import re
from dataclasses import replace

import numpy as np
import pytest

import g1stream
from g1stream.app.rollout import rollout
from g1stream.config import Config, SimConfig
from g1stream.control.combinations import require_combination
from g1stream.control.loop import make_loop
from g1stream.control.plan import plan
from g1stream.control.sources import load_source
from g1stream.errors import ConfigError, MotionError, SafetyError
from g1stream.extras.feet.source import StandingTorques
from g1stream.extras.physics.example_motions import squatting, stepping
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1, REVISIONS
from g1stream.robot.rotations import (
    quat_from_rpy,
    quat_rotate,
    quat_rotate_inverse,
    tilt_of,
    yaw_of,
)
from g1stream.sim.lockstep import Lockstep
from g1stream.sim.robot import SensorNoise, SimulatedRobot
from g1stream.sim.world import World
from g1stream.types import Phase

pytest.importorskip("daqp")

SHORT = {"ramp": 1.0, "hold": 0.2, "damp": 0.5}


def config(noise=0.0, **stream):
    stream = SHORT | {"support": "feet"} | stream
    return Config.model_validate({"sim": {"noise": noise}, "stream": stream})


@pytest.mark.slow
def test_it_stands_and_follows_the_reference():
    session = rollout(squatting(2.0), config=config(noise=1.0, ramp=1.5))
    played = session.metadata["stream"]
    assert played["reason"] == ""
    assert played["support"] == "feet"
    assert len(session.metadata["motion"]["operations"]) == 1  # it was changed to stand
    assert not any("with changes to stand" in problem for problem in session.summary().problems)
    assert any("with changes to stand" in event.text for event in session.log)
    assert session.tracking().overall < 0.004
    success = session.metrics().success
    assert (success.links, success.success, success.success_strict) == ("world", True, True)
    playing = session.base.time < 2.0
    assert session.base.position[playing, 2].min() > 0.6
    balance = session.summary().stream.balance
    assert (balance.lifts, balance.unsolved_ticks) == (0, 0)
    assert balance.capture_margin_m > 0.03
    assert balance.carried > 0.8
    playing &= session.base.time > 0.0
    reference = session.reference
    height = np.interp(session.base.time[playing], reference.time, reference.root_pos[:, 2])
    off = np.abs(session.base.position[playing, 2] - height).max()
    assert off - 2e-3 < balance.height_error_m < 0.01
    # The feet take the weight before the robot is let go: the legs do not give way.
    after = (session.base.time > 0.0) & (session.base.time < 0.1)
    assert np.abs(session.base.velocity[after, 2]).max() < 0.05


def test_all_joints_of_a_robot_on_its_feet_move():
    planned = plan("demo", config(joints="arms"), simulated=True)
    assert (planned.played.sum(), planned.moved.sum()) == (14, 29)


def flags_in(remedy):
    """The settings of each way in a remedy that gives flags."""
    for way in remedy.split("; or "):
        given = dict(re.findall(r"--(start|duration|joints) ([\w.,]*\w)", way))
        if given:
            yield {name: one if name == "joints" else float(one) for name, one in given.items()}


@pytest.mark.parametrize(
    ("asked", "ends"),
    [({"start": 1.0, "duration": 12.0}, 6.2), ({"joints": "legs"}, 14.0)],
)
def test_what_a_remedy_gives_can_be_played(asked, ends):
    """The bundled demo, with a hop at 6.3 to 6.5 s and a jump of an arm at 11 s."""
    demo = load_motion("demo")
    root, pos = demo.root_pos.copy(), demo.joint_pos.copy()
    root[190:196, 2] += 0.2
    pos[330:, JOINT_NAMES.index("left_shoulder_roll_joint")] += 2.0
    hopping = replace(demo, root_pos=root, joint_pos=pos)
    with pytest.raises(MotionError) as raised:
        StandingTorques(config(**asked), G1.default()).prepare(hopping)
    ways = list(flags_in(raised.value.remedy))
    assert len(ways) == 2
    for given in ways:
        StandingTorques(config(**asked | given), G1.default()).prepare(hopping)
    own, upper = ways
    assert own["start"] + own["duration"] == pytest.approx(ends, abs=0.07)
    assert (upper["joints"], upper["start"]) == ("arms,waist", asked.get("start", 0.0))
    assert upper["start"] + upper["duration"] == pytest.approx(10.9, abs=0.07)


def test_a_speed_that_a_remedy_gives_can_be_played():
    quick = stepping(np.outer([1, 1], [0.12, 0.0, 0.0])).at_speed(3.0)
    with pytest.raises(MotionError) as raised:
        g1stream.physics.stand(quick)
    speed = float(re.search(r"at ([\d.]+) times this speed", raised.value.remedy)[1])
    assert g1stream.physics.stand(quick.at_speed(speed)).motion.duration > quick.duration


def test_a_motion_is_made_to_stand_by_name_and_for_some_joints(standing_demo, tmp_path):
    arms = g1stream.physics.stand("demo", "arms")
    assert (standing_demo.upper_body, arms.upper_body) == (False, True)
    saved = standing_demo.motion.save(tmp_path / "demo.npz")
    assert g1stream.physics.stand(saved).joint_deg < 0.5 * standing_demo.joint_deg
    with pytest.raises(ConfigError):
        g1stream.physics.stand("demo", "left_leg")
    with pytest.raises(ConfigError, match="23"):
        g1stream.physics.stand("demo", robot=G1.load("g1_23dof"))


@pytest.mark.slow
def test_it_steps_to_where_the_motion_goes():
    """A step of each foot, to the left in a turn; measured in the simulator."""
    goal = (0.05, 0.05, 0.4)
    world = World(G1.default(), "free")
    feet = [world.model.body(f"{side}_ankle_roll_link").id for side in ("left", "right")]
    stood = []
    add = SensorNoise(seed=7)

    def follow(loop, state):
        add(state)
        if loop.state.phase is Phase.PLAY:
            turns = world.data.xmat[feet].reshape(2, 3, 3)
            stood.append((world.data.xpos[feet].copy(), yaw_of(world.data.xquat[feet]), turns))

    loop = play(world, stepping([goal, goal], period=1.2), "free", follow)
    assert loop.report.stop is None
    assert len(stood) == pytest.approx(500 * 4.8, abs=2)
    (first, turned, _), (last, turned_last, level) = stood[0], stood[-1]
    x, y, heading = goal
    # As seen from between the feet where the robot began.
    begun = quat_from_rpy(np.array([0.0, 0.0, turned.mean()]))
    way = quat_rotate_inverse(begun, last - first.mean(axis=0))
    turn = quat_from_rpy(np.array([0.0, 0.0, heading]))
    links = quat_rotate(turn, np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]))
    assert way[:, :2] == pytest.approx(links[:, :2] + np.array([x, y]), abs=5e-3)
    assert turned_last - turned == pytest.approx(np.full(2, heading), abs=0.01)
    assert level[:, 2, 2] == pytest.approx(np.ones(2), abs=1e-3)
    assert loop.report.summary().balance.lifts == 2
    apart = np.diff(way[:, :2] - links[:, :2], axis=0)
    assert np.linalg.norm(apart) - 2e-3 < loop.report.summary().balance.feet_error_m < 0.015


def test_it_is_refused_where_there_may_be_a_robot():
    def made(**more):
        asked = {"dds": {"interface": "eth0"}, "stream": {"support": "feet"}} | more
        settings = Config.model_validate(asked)
        require_combination(settings, G1.default(), simulated=False)
        return load_source(settings, G1.default(), simulated=False)

    with pytest.raises(SafetyError, match="eth0"):
        made()
    with pytest.raises(SafetyError):
        made(profile="robot")
    assert isinstance(made(profile="network-simulator"), StandingTorques)


def play(world, motion, announced, on_state):
    """The loop of a motion on a world, in lockstep; `on_state` gets it and every LowState."""
    simulated = SimulatedRobot(world, SimConfig(), noise=lambda state: on_state(loop, state))
    link = Lockstep(simulated, announced)
    loop = make_loop(plan(motion, config(), simulated=True), link, link, settle=0)
    loop.run()
    return loop


@pytest.mark.slow
@pytest.mark.parametrize("requests", [1, 2])
def test_a_requested_stop_squats_and_a_second_one_damps_at_once(requests):
    world = World(G1.default(), "free")
    heights = {}

    def stop(loop, _state):
        phase = loop.state.phase
        heights[phase] = float(world.data.qpos[2])
        playing = phase is Phase.PLAY and loop.motion_time > 0.3
        if (playing and not loop.stop_requests) or (phase is Phase.HOLD and requests == 2):
            loop.request_stop("enough")

    loop = play(world, squatting(1.0), "free", stop)
    assert loop.report.stop.text == "enough"
    assert (heights[Phase.HOLD] < 0.65) == (requests == 1)


@pytest.mark.slow
def test_a_robot_that_hangs_is_lowered_onto_its_feet_and_stands():
    """As in unitree_mujoco: a band that is lowered, and let go once PLAY has begun.

    The robot is not of the revision that the loop assumes until it has moved.
    """
    (name,) = (one for one in REVISIONS if one != G1.default().name)
    world = World(G1.load(name), "hanging")
    band = world._support
    heights, waited = [], []

    def lower(loop, _state):
        if loop.state.phase is Phase.RAMP and loop.state.elapsed(loop._clock.now()) > 1.0e9:
            waited.append(float(world.data.qpos[2]))
            band._TOP -= 0.0008  # 0.4 m/s
        elif loop.state.phase is Phase.PLAY:
            band._STIFFNESS = band._DAMPING = 0.0
            heights.append(float(world.data.qpos[2]))

    loop = play(world, squatting(0.5), None, lower)
    assert loop.report.stop is None
    assert loop.report.summary().robot == name
    assert waited[0] > 1.0  # it hung in the air
    assert len(heights) == 250
    assert min(heights) > 0.68


@pytest.mark.slow
@pytest.mark.parametrize(
    ("push", "stands"),
    [((0.0, 170.0), True), ((100.0, 0.0), False), ((0.0, 220.0), False)],
)
def test_a_push_is_stood_or_the_fall_is_seen_before_the_pelvis_tilts(push, stands):
    """For 0.1 s, at the torso; with 170 N to the left the pelvis goes aside by some 15 cm."""
    world = World(G1.default(), "free")
    torso = world.model.body("torso_link").id
    tilts = []

    def shove(loop, _state):
        elapsed = loop.state.elapsed(loop._clock.now()) / 1e9
        pushed = loop.state.phase is Phase.PLAY and 0.5 <= elapsed < 0.6
        world.data.xfrc_applied[torso, :2] = np.multiply(push, pushed)
        if loop.state.phase < Phase.DAMP:
            tilts.append(tilt_of(world.data.qpos[3:7]))

    loop = play(world, squatting(1.6), "free", shove)
    assert (loop.report.stop is None) == stands
    assert stands or "capture point" in loop.report.stop.text
    assert (loop.report.summary().balance.capture_margin_m > -0.01) == stands
    assert max(tilts) < 0.2
