"""A motion played in lockstep: deterministic, in simulated time, a session like a recorded one."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from g1stream.analysis.summarise import find_problems
from g1stream.app.rollout import LATENCY, rollout
from g1stream.app.session import Session, open_session
from g1stream.config import Config, load_config
from g1stream.control.stop import REMEDIES
from g1stream.errors import ConfigError, RecordingError
from g1stream.robot.joints import JOINT_NAMES
from g1stream.session.source import ExtendedSource, MemorySource
from g1stream.session.streams import MeasuredStream
from g1stream.sim.lockstep import EPOCH
from g1stream.types import Phase

SHORT = {"ramp": 1.0, "hold": 0.1, "damp": 0.5}


def config(**values):
    return Config.model_validate({"stream": SHORT} | values)


@pytest.fixture(scope="module")
def session() -> Session:
    return rollout("demo", seconds=1.0, config=config())


def test_gains_are_a_number_or_by_joint(session):
    def gains(session):
        play = session.command[(session.command.time > 0.0) & (session.command.time < 0.1)]
        return play.kp[0], play.kd[0]

    def play(*, kp, kd=None, **settings):
        return gains(rollout("demo", seconds=0.1, config=config(**settings), kp=kp, kd=kd))

    usual, damping = gains(session)
    kp, kd = play(kp=60, kd={"arms": 1.5, "left_elbow_joint": 2.5})
    assert set(kp) == {60.0}
    elbow, right = (JOINT_NAMES.index(f"{side}_elbow_joint") for side in ("left", "right"))
    assert (kd[elbow], kd[right]) == (2.5, 1.5)
    np.testing.assert_array_equal(kd[:15], damping[:15])
    given = {"kp": {"left_knee_joint": 123.0, "legs": 80.0}}
    over, _ = play(kp={"waist": 90.0}, gains=given)
    knee = JOINT_NAMES.index("left_knee_joint")
    assert (over[knee], over[12], over[elbow]) == (80.0, 90.0, usual[elbow])
    with pytest.raises(ConfigError, match="tail"):
        play(kp={"tail": 60.0})
    with pytest.raises(ConfigError, match=r"gains\.kp"):
        play(kp=-1.0)


@pytest.mark.slow
def test_it_is_the_same_byte_for_byte(session):
    again = rollout("demo", seconds=1.0, config=config())
    assert again.topics == session.topics
    assert again.metadata == session.metadata
    for topic in session.topics:
        assert list(again.messages(topic)) == list(session.messages(topic))


def test_times_are_simulated(session):
    reference, state = session.reference, session.measured
    first = int(reference.publish_time[0])
    assert EPOCH <= first < EPOCH + 1_000_000_000
    assert np.unique(np.diff(reference.publish_time)).tolist() == [2_000_000]
    assert np.unique(np.diff(state.publish_time)).tolist() == [2_000_000]
    assert {(t - first) % 2_000_000 for t in state.publish_time.tolist()} == {1_000_000}
    for topic in ("/lowcmd", "/lowstate", "/reference", "/sportmodestate", "/log", "/tf"):
        assert {m.log_time - m.publish_time for m in session.messages(topic)} == {LATENCY}
    assert session.command.publish_time.tolist() == reference.publish_time.tolist()
    summary = session.summary()
    assert summary.simulated
    assert "2000-01-01" not in summary.details
    assert {stats.latency_us for stats in summary.topics.values()} == {None}
    assert session.metrics().timing.state_age_us.max == pytest.approx(1000.0)


def test_every_phase_and_channel_is_there(session):
    durations = {one.phase: one.duration_s for one in session.phases}
    tick = 1.0 / config().stream.rate
    assert 0 <= durations[Phase.RAMP] - session.metadata["stream"]["ramp_s"] < tick
    assert durations[Phase.RAMP] > config().stream.ramp  # the demo begins 1 rad away
    assert durations[Phase.PLAY] == pytest.approx(1.0)
    assert durations[Phase.DAMP] == pytest.approx(0.5, abs=0.003)
    assert set(session.topics) == {
        *("/lowcmd", "/lowstate", "/reference", "/sportmodestate", "/secondary_imu"),
        *("/tf", "/measured/tf", "/reference/joint_states", "/measured/joint_states"),
        *("/tracking_error/joint_states", "/tracking_error/limbs"),
        *("/timing/commands", "/timing/states", "/log"),
        *("/ghost/tf", "/scene", "/measured/scene", "/ghost/scene", "/measured/path"),
        "/measured/robot_description",
    }
    assert session.attachments.keys() >= {"robot.urdf", "config.json"}
    assert session.metadata["motion"]["name"] == "demo"
    assert session.metadata["stream"]["reason"] == ""
    assert {event.name for event in session.log} == {"stream", "sim"}
    assert "RAMP -> PLAY" in {event.text for event in session.log}


@pytest.mark.parametrize(
    ("settings", "how", "named"),
    [
        ({"stream": {"loop": True}}, {}, "stream.loop"),
        ({"stream": {"start": 1e4}}, {}, "10000 s"),
        ({}, {"support": "foot"}, "'foot'"),
        ({}, {"seconds": -1}, r"stream\.duration.*-1"),
    ],
)
def test_what_cannot_be_played(settings, how, named):
    with pytest.raises(ConfigError, match=named):
        rollout("demo", config=Config.model_validate(settings), **how)


@pytest.mark.parametrize("recorded", [False, True])
def test_a_robot_that_falls_is_one_problem_with_one_remedy(tmp_path, recorded):
    """The log has the end of the stream, too."""
    session = rollout("demo", seconds=3.0, support="free", config=config())
    assert any(event.is_serious for event in session.log)
    if recorded:
        session = open_session(session.save(tmp_path / "fallen.mcap"))
    summary = session.summary()
    assert summary.stream.stop == "tilt"
    (problem,) = summary.problems
    assert problem.endswith(REMEDIES["tilt"])


def test_joints_that_do_not_follow_are_a_problem_unless_a_policy_plays():
    weak = load_config(over={"gains.kp": {"*": 1.0}, "gains.kd": {"*": 0.1}})
    session = rollout("demo", seconds=3.0, config=weak)
    summary, states = session.summary(), session.measured
    play = next(one for one in session.phases if one.phase is Phase.PLAY)
    inside = (states.time >= play.start_s) & (states.time <= play.end_s)
    times, reference = states.time[inside], session.reference
    asked = [np.interp(times, reference.time, q) for q in reference.q.T]
    rmse = np.sqrt(np.mean((np.array(asked) - states.q[inside].T) ** 2, axis=1))
    (problem,) = summary.problems
    assert problem.startswith(f"{(rmse > 0.3).sum()} joints ")
    assert JOINT_NAMES[rmse.argmax()] in problem
    summary.settings = {"stream.policy": "policy.onnx"}
    assert [*find_problems(summary)] == []


def test_a_simulated_robot_needs_no_remote_and_no_kind():
    config = load_config(over={"safety.deadman": "R1", "safety.mode_machine": [7]})
    assert rollout("demo", config=config, seconds=0.1).summary().termination.reason == ""


@pytest.mark.slow
def test_a_loop_plays_as_long_as_asked():
    looped = rollout("demo", seconds=0.5, config=config(stream=SHORT | {"loop": True}))
    assert {one.phase: one.duration_s for one in looped.phases}[Phase.PLAY] == pytest.approx(0.5)


@pytest.mark.slow
def test_it_is_saved_as_a_recorder_writes_it(session, tmp_path):
    path = session.save(tmp_path / "rollout.mcap")
    saved = open_session(path)
    assert saved.complete
    assert saved.topics == session.topics
    for topic in session.topics:
        assert list(saved.messages(topic)) == list(session.messages(topic))
    assert saved.metadata == session.metadata
    assert saved.attachments == session.attachments
    assert saved.tracking().overall == session.tracking().overall
    assert saved.summary().problems == session.summary().problems == []
    with pytest.raises(RecordingError, match=r"rollout\.mcap"):
        session.save(path)
    part = open_session(session.sel("PLAY").save(tmp_path / "play.mcap"))
    assert [one.phase for one in part.phases] == [Phase.PLAY]
    assert len(part.reference) == len(session.sel("PLAY").reference)
    (shown,), (shapes,) = (one.messages("/measured/scene") for one in (part, session))
    first = next(iter(session.sel("PLAY").messages("/reference")))
    assert shown == shapes._replace(log_time=first.log_time)
    assert shapes.log_time < first.log_time


def test_a_part_of_a_split_recording_shows_the_robot_once(session, tmp_path):
    """Each part of a recording begins with the shapes; a saved part has those before it."""
    scenes, again = "/measured/scene", open_session(session.save(tmp_path / "whole.mcap"))
    (shapes,) = again.messages(scenes)
    middle = again.start_ns + 300_000_000
    added = MemorySource()
    for log_time, data in ((shapes.log_time, b"old"), (middle, shapes.data), (2 * middle, b"new")):
        added.write(scenes, data, log_time, log_time)
    split = Session(ExtendedSource(again.source, added))
    path = split.sel(time=slice(0.4, 0.6)).save(tmp_path / "part.mcap")
    (shown,) = open_session(path).messages(scenes)
    assert shown.data == shapes.data
    assert shown.log_time > middle


def test_excerpts_need_no_times_that_were_read_before(session, tmp_path):
    path, rows = session.save(tmp_path / "r.mcap"), np.array([3, 100, 200])
    found = open_session(path).excerpts({MeasuredStream: (rows, ["q"])})[MeasuredStream]
    np.testing.assert_array_equal(found.q, session.measured.q[rows])


@pytest.fixture(scope="module")
def arms() -> Session:
    over = {"stream": SHORT | {"others": "free"}}
    return rollout("demo", seconds=1.0, joints="arms", config=Config.model_validate(over))


def test_joints_that_are_free_only_damp(arms):
    command = arms.command[arms.reference.phase < Phase.DAMP]
    assert not command.kp[:, :15].any()
    assert not command.tau[:, :15].any()
    assert not command.dq[:, :15].any()
    assert (command.kp[:, 15:] == 40.0).all()
    assert np.ptp(arms.measured.q[:, :15], axis=0).max() > 0.1  # the torso leans
    assert arms.summary().termination.reason == ""


def test_only_played_joints_count(arms, session):
    names = list(JOINT_NAMES[15:])
    summary, metrics, tracking = arms.summary(), arms.metrics(), arms.tracking()
    assert arms.metadata["joints"] == summary.joints == names
    assert list(summary.tracking.joints) == list(metrics.tracking.joints) == names
    assert list(summary.tracking.limbs) == ["left_arm", "right_arm"]
    assert list(metrics.tracking.limbs) == ["left_arm", "right_arm"]
    assert list(metrics.torque.joints) == names
    assert tracking.joints == tuple(range(15, 29))
    assert tracking.overall == pytest.approx(np.sqrt(np.mean(tracking.rmse[15:] ** 2)))
    assert metrics.tracking.all_joints.rmse_rad == pytest.approx(tracking.overall)
    assert tracking.rmse[:15].max() > tracking.overall  # the legs, which fell
    links = metrics.body.pelvis_frame.by_link_mm
    assert len(links) == 14
    assert all("shoulder" in link or "elbow" in link or "wrist" in link for link in links)
    assert (arms.reference.played == sum(1 << joint for joint in range(15, 29))).all()
    assert (session.reference.played == 2**29 - 1).all()
    assert session.metadata["joints"] == list(JOINT_NAMES)


def test_the_error_of_a_limb_is_that_of_its_played_joints(arms):
    *_, last = (JointStates.FromString(m.data) for m in arms.messages("/tracking_error/limbs"))
    *_, joints = (
        JointStates.FromString(m.data) for m in arms.messages("/tracking_error/joint_states")
    )
    assert last.timestamp == joints.timestamp
    error = np.array([joint.position for joint in joints.joints])
    found = {joint.name: joint.position for joint in last.joints}
    unknown = [name for name, value in found.items() if np.isnan(value)]
    assert unknown == ["left_leg", "right_leg", "waist"]
    assert found["left_arm"] == pytest.approx(np.sqrt(np.mean(error[15:22] ** 2)))
