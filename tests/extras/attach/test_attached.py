import numpy as np
import pytest

import g1stream
from g1stream.app.session import Session
from g1stream.config import Config
from g1stream.dds.messages import LOWCMD, LOWSTATE, SPORTMODESTATE, encode_samples
from g1stream.errors import ConfigError, RecordingError
from g1stream.extras.attach.attached import Recorded, find_motion
from g1stream.extras.attach.write import write_attached
from g1stream.motion.motion import Motion
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.rotations import quat_from_yaw, quat_mul, quat_rotate, yaw_of
from g1stream.session.source import MemorySource
from g1stream.types import Phase

T0 = 1_700_000_000_000_000_000
LATENCY = 100_000
SECONDS = 12
ELSEWHERE = np.array([3.0, -2.0, 0.0])


@pytest.fixture(scope="module")
def motion():
    """All joints, walking and turning."""
    rng = np.random.default_rng(5)
    seconds = np.arange(SECONDS * 30 + 1) / 30.0
    angle = 2.0 * np.pi * rng.uniform(0.1, 1.2, (3, 29)) * seconds[:, np.newaxis, np.newaxis]
    q = (0.1 * np.sin(angle + rng.uniform(0.0, 6.0, (3, 29)))).sum(axis=1)
    place = np.column_stack([0.08 * seconds, 0.0 * seconds, 0.0 * seconds + 0.78])
    return Motion("made", 30.0, q, place, quat_from_yaw(0.3 + 0.02 * seconds))


@pytest.fixture(scope="module")
def strangers(motion):
    """Writes what a controller of somebody else and a recorder leave; the robot is late.

    The world is turned by 0.7 rad and elsewhere; the motion's first frame is 4 s after the first
    message, and 24 s after it if it is played twice. The joints `stuck` do not move, and those
    `unasked` have other targets; `clock` is added to publish times, ns.
    """

    def write(
        *topics, late=0.015, speed=1.0, targets=1.0, twice=False, stuck=(), unasked=(), clock=0
    ):
        times = np.arange(0.0, 38.0 if twice else 18.0, 0.01)

        def at(when):
            begun = np.where(when > 20.0, when - 20.0, when) if twice else when
            return Trajectory(motion).sample_many((speed * (begun - 4.0)).clip(0.0))

        asked, done = at(times), at(times - late)
        asked.joint_pos[:, list(unasked)], done.joint_pos[:, list(stuck)] = 0.0, 0.2
        samples = {
            LOWCMD: {
                "motor_cmd.q": targets * asked.joint_pos,
                "motor_cmd.kp": np.full((len(times), 29), 40.0),
            },
            LOWSTATE: {
                "motor_state.q": done.joint_pos,
                "motor_state.dq": speed * done.joint_vel,
                "imu_state.quaternion": quat_mul(quat_from_yaw(0.7), done.root_quat_wxyz),
            },
            SPORTMODESTATE: {
                "position": quat_rotate(quat_from_yaw(0.7), done.root_pos) + ELSEWHERE
            },
        }
        source = MemorySource("stranger")
        stamps = T0 + np.round(times * 1e9).astype(np.int64)
        for topic in topics:
            data = encode_samples(topic, samples[topic], len(times))
            source.write_batch(
                topic.name.replace("rt/", "/"), data, stamps + LATENCY, stamps + clock
            )
        return Session(source)

    return write


@pytest.fixture(scope="module")
def attached(strangers, motion):
    return strangers(LOWCMD, LOWSTATE, SPORTMODESTATE).attach(motion)


def start_of(session):
    """When the motion's first frame was, s after the first message."""
    return (session.start_ns - T0) / 1e9


def test_commands_tell_when_the_motion_began_and_the_robot_how_late_it_is(attached):
    assert attached.attached.by == "commands"
    assert start_of(attached) == pytest.approx(4.0, abs=1e-3)
    assert attached.tracking().delay.seconds == pytest.approx(0.015, abs=1e-3)
    assert attached.summary().tracking.compared_s == pytest.approx(SECONDS, abs=0.05)
    assert attached.summary().problems == []


@pytest.mark.parametrize("rate", [25, 50, 100])
@pytest.mark.parametrize("repeated", [False, True])
def test_a_target_that_is_repeated_counts_once(motion, rate, repeated):
    """A robot holds each target from 8 ms after it was first sent."""
    trajectory = Trajectory(motion)
    times = np.arange(0.0, 18.0, 0.002)
    steps = np.floor(times * rate + 1e-6) / rate
    sent = times if repeated else np.unique(steps)
    targets = np.floor(sent * rate + 1e-6) / rate
    held = np.floor((times - 0.008) * rate + 1e-6) / rate
    source = MemorySource("stranger")
    for topic, when, values in (
        (LOWCMD, sent, {"motor_cmd": targets}),
        (LOWSTATE, times, {"motor_state": held}),
    ):
        ((part, at),) = values.items()
        q = trajectory.sample_joints((at - 4.0).clip(0.0))[0]
        fields = {f"{part}.q": q} | ({"motor_cmd.kp": q * 0.0 + 40.0} if topic is LOWCMD else {})
        if topic is LOWSTATE:
            fields["imu_state.quaternion"] = np.tile([1.0, 0.0, 0.0, 0.0], (len(when), 1))
        stamps = T0 + np.round(when * 1e9).astype(np.int64)
        data = encode_samples(topic, fields, len(when))
        source.write_batch(topic.name.replace("rt/", "/"), data, stamps + LATENCY, stamps)
    session = Session(source).attach(motion)
    assert session.attached.by == "commands"
    assert start_of(session) == pytest.approx(4.0, abs=2e-4)
    late = np.mean(times - held)
    assert session.tracking().delay.seconds == pytest.approx(late, abs=2e-4)


@pytest.mark.parametrize("topics", [(LOWSTATE,), (LOWCMD, LOWSTATE)])
def test_by_the_robot_its_lag_is_part_of_the_start_and_no_delay_is_told(strangers, motion, topics):
    """Where there are no commands, or their targets are there for their torque."""
    source = strangers(*topics, targets=1.6).source
    source.add_metadata({"absent": ["left_wrist_yaw_joint"]})
    session = Session(source).attach(motion)
    assert session.attached.by_robot
    assert start_of(session) == pytest.approx(4.015, abs=2e-3)
    assert session.tracking().overall < 2e-3
    assert session.tracking().delay is None
    assert session.metrics().tracking.all_joints.delay_s is None
    assert 21 not in session.tracking().joints
    assert "unknown: the robot's own joints" in str(session.summary())


def test_references_are_the_motion_at_its_speed_where_the_pelvis_was(strangers, motion):
    session = strangers(LOWCMD, LOWSTATE, SPORTMODESTATE, late=0.0, speed=0.9).attach(motion)
    reference, info = session.reference, session.attached
    assert info.speed == pytest.approx(0.9, rel=1e-3)
    assert set(reference.phase) == {Phase.PLAY}
    point = Trajectory(motion).sample_many(reference.motion_time)
    np.testing.assert_allclose(reference.q, point.joint_pos, atol=1e-6)
    np.testing.assert_allclose(reference.dq, 0.9 * point.joint_vel, atol=2e-3)
    np.testing.assert_allclose(reference.time, reference.motion_time / info.speed, atol=1e-6)
    assert (info.heading_from, info.place_from, info.moves) == ("imu", "sportmodestate", True)
    base = session.base
    for axis in range(3):
        measured = np.interp(reference.time, base.time, base.position[:, axis])
        np.testing.assert_allclose(reference.root_pos[:, axis], measured, atol=5e-3)
    yaw = yaw_of(reference.root_quat_wxyz)
    measured = np.interp(
        reference.time, session.measured.time, yaw_of(session.measured.imu_quat_wxyz)
    )
    np.testing.assert_allclose(yaw, measured, atol=5e-3)
    assert session.metrics().body.world.mpjpe_mm < 10.0


def test_a_second_play_is_another_session(strangers, motion):
    session = strangers(LOWCMD, LOWSTATE, twice=True)
    first, second = session.attach(motion), session.attach(motion, play=2)
    assert (first.attached.plays, second.attached.play) == (2, 2)
    assert [start_of(first), start_of(second)] == pytest.approx([4.0, 24.0], abs=1e-3)
    with pytest.raises(ConfigError, match="2 times"):
        session.attach(motion, play=3)


def test_commands_that_are_not_finite_tell_nothing(strangers, motion):
    asked = Recorded("commands", np.arange(5), np.full((5, 29), np.nan))
    assert find_motion([asked], Trajectory(motion)) is None


def test_joints_that_are_stuck_count_and_joints_that_were_not_commanded_do_not(strangers, motion):
    stuck = strangers(LOWSTATE, stuck=[3]).attach(motion).tracking()
    assert len(stuck.joints) == 29
    assert stuck.worst_joint == "left_knee_joint"
    unasked = strangers(LOWCMD, LOWSTATE, unasked=range(15)).attach(motion).tracking()
    assert unasked.joints == tuple(range(15, 29))


def test_our_own_rollout_gets_its_reference_back():
    config = Config.model_validate({"stream": {"ramp": 1.0, "hold": 0.1, "damp": 0.5}})
    whole = g1stream.rollout("demo", seconds=5.0, config=config)
    source = MemorySource("without")
    for topic in whole.topics.keys() - {"/reference"}:
        for message in whole.messages(topic):
            source.write(topic, message.data, message.log_time, message.publish_time)
    source.add_metadata(whole.metadata)
    session = Session(source).attach("demo")
    assert session.start_ns == pytest.approx(whole.start_ns, abs=1e6)
    assert session.attached.speed == pytest.approx(1.0, rel=1e-3)
    assert session.tracking().overall == pytest.approx(whole.tracking().overall, rel=0.1)


def test_what_is_written_has_all_that_a_session_has(attached, tmp_path):
    path = write_attached(attached, tmp_path / "attached.mcap")
    session = g1stream.open_session(path)
    assert session.attached == attached.attached
    for topic in ("/lowcmd", "/lowstate", "/sportmodestate", "/reference"):
        assert [*session.messages(topic)] == [*attached.messages(topic)]
    shown = {"/tf", "/ghost/tf", "/measured/tf", "/reference/joint_states", "/ghost/scene"}
    assert shown | {"/tracking_error/joint_states"} <= session.topics.keys()
    assert session.topics["/tf"] == pytest.approx(100 * SECONDS, abs=5)
    assert session.tracking().overall == attached.tracking().overall
    assert session.metadata["measured_tf"]["yaw_offset_rad"] == pytest.approx(0.0, abs=1e-3)
    with pytest.raises(RecordingError, match="attached"):
        write_attached(attached, path)


def test_refusals(strangers, attached, motion):
    with pytest.raises(RecordingError, match="has a reference"):
        attached.attach(motion)
    torques = MemorySource("torques")
    data = encode_samples(LOWCMD, {"motor_cmd.tau": np.ones((3, 29))}, 3)
    torques.write_batch("/lowcmd", data, T0 + np.arange(3), T0 + np.arange(3))
    with pytest.raises(RecordingError, match="neither commands nor states"):
        Session(torques).attach(motion)
    with pytest.raises(RecordingError, match="whole session"):
        strangers(LOWSTATE).sel(time=slice(0.0, 5.0)).attach(motion)


def test_a_second_is_no_recording_and_a_clock_may_leap_by_years(strangers, motion):
    source = strangers(LOWSTATE).source
    _, state = next(source.batches({"/lowstate"}))
    short, leaping = MemorySource("short"), MemorySource("leaping")
    short.write_batch("/lowstate", state.data[:3], state.log_times[:3], state.publish_times[:3])
    with pytest.raises(RecordingError, match="was not found"):
        Session(short).attach(motion)
    times = state.publish_times.copy()
    times[:20] -= 10**18
    leaping.write_batch("/lowstate", state.data, times, times)
    begun = Session(leaping).attach(motion).start_ns
    assert begun == pytest.approx(T0 + 4_015_000_000, abs=2_000_000)


def test_references_are_on_the_clock_of_the_state_where_that_is_another(strangers, motion):
    """The written file then has a tracking error."""
    attached = strangers(LOWCMD, LOWSTATE, clock=60_000_000_000).attach(motion)
    assert attached.reference.publish_time[0] > T0 + 60_000_000_000
    assert attached.start_ns == pytest.approx(T0 + 4_000_000_000 + LATENCY, abs=1_000_000)
    assert attached.tracking().delay.seconds == pytest.approx(0.015, abs=1e-3)
