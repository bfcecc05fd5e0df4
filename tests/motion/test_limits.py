import logging
from dataclasses import replace

import numpy as np
import pytest

from g1stream.app.stream import stream
from g1stream.config import Config
from g1stream.control.limits import PositionLimit
from g1stream.control.loop import StreamLoop
from g1stream.motion.limits import POSITION_TOLERANCE, Interval, measure_limits
from g1stream.motion.trajectory import Trajectory
from g1stream.robot.joints import JOINT_NAMES

KNEE, WAIST = JOINT_NAMES.index("left_knee_joint"), JOINT_NAMES.index("waist_yaw_joint")
ELBOW = JOINT_NAMES.index("left_elbow_joint")


def measured(motion, robot, interval=None, *, loop=False, **options):
    return measure_limits(Trajectory(motion, loop=loop), robot, interval, **options)


@pytest.fixture
def spike(make_motion, robot):
    """Four seconds at rest in mid range, but for a knee and an elbow in one frame, at 3 s."""
    joints = np.tile((robot.lower + robot.upper) / 2, (121, 1))
    joints[90, KNEE], joints[90, ELBOW] = 9.0, 2.5
    return make_motion(joints)


@pytest.mark.parametrize(
    ("start", "length", "loop", "n"),
    [
        (0.0, 2.0, False, 0),
        (2.5, 1.0, False, 2),
        (3.99, None, False, 0),
        (0.0, 2.0, True, 0),
        (3.5, 2.0, True, 0),
        (3.5, None, True, 2),
    ],
)
def test_only_what_is_played_counts(spike, robot, start, length, loop, n):
    interval = Interval(start, length, loop)
    report = measured(spike, robot, interval, loop=loop)
    assert len(report.warnings) == n
    assert len(report.held) == len(report.too_fast) == n
    for joint in report.held:
        assert joint.time == pytest.approx(3.0, abs=0.003)


def test_the_seam_of_a_loop_counts(spike, robot):
    """Out of a last frame within the limit, but fast, it passes the limit before it turns back."""
    angles = np.tile((robot.lower + robot.upper) / 2, (121, 1))
    angles[:, KNEE] = robot.upper[KNEE] - 2.5 * (1.0 - (np.arange(121) / 120) ** 4)
    rising = replace(spike, joint_pos=angles)
    assert measured(rising, robot).held == ()
    once = Interval(0.0, rising.duration, loop=True)
    assert measured(rising, robot, once, loop=True).held == ()
    report = measured(rising, robot, replace(once, length=None), loop=True)
    (knee,) = report.held
    assert knee.joint == "left_knee_joint"
    assert knee.time > rising.duration
    assert "on the way back to its first frame" in report.warnings[0]


def test_warnings_snapshot(spike, robot):
    report = measured(spike, robot, position_margin=0.1)
    assert report.warnings == (
        "made moves left_knee_joint to 9.000 rad at 3.00 s, limit 2.780 less a margin of 0.1; also "
        f"left_elbow_joint. {report.n_held} joint targets at 500 Hz clamped to the limit.",
        f"made moves left_knee_joint at {report.too_fast[0].value:.1f} rad/s at "
        f"{report.too_fast[0].time:.2f} s, limit 20; also left_elbow_joint. Joints that cannot "
        "follow lag behind.",
    )


@pytest.mark.parametrize(
    ("side", "excess", "levels"),
    [
        (1, 0.01, [logging.INFO]),
        (-1, 0.01, [logging.INFO]),
        (-1, 0.03, [logging.WARNING]),
        (1, -0.1, []),
    ],
)
def test_a_slight_excess_is_not_logged_as_a_warning(make_motion, robot, side, excess, levels):
    """Of the joint that is furthest beyond; what is too fast is a warning anyhow."""
    angles = np.zeros((61, 29))
    limit = robot.upper if side > 0 else robot.lower
    for joint, share in ((KNEE, 1.0), (WAIST, 0.3)):
        angles[:, joint] = limit[joint] + side * share * excess
    angles[::2, ELBOW] = 1.0
    *held, fast = measured(make_motion(angles), robot).events
    assert [level for level, _ in held] == levels
    assert all("left_knee_joint" in text for _, text in held)
    assert fast[0] == logging.WARNING


@pytest.mark.dds
def test_the_stream_warns_before_the_first_command(spike, domain_id, monkeypatch, caplog):
    config = Config.model_validate(
        {"dds": {"domain": domain_id}, "stream": {"beyond_limits": "clamp"}}
    )
    monkeypatch.setattr(StreamLoop, "run", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        stream(spike, config)
    warned = [one.getMessage() for one in caplog.records if one.levelno == logging.WARNING]
    assert sum(text.startswith("made ") for text in warned) == 2


@pytest.mark.parametrize(
    ("loop", "interval", "rate", "margin"),
    [(False, (0.3, 0.55), 500.0, 0.0), (False, None, 90.0, 0.05), (True, None, 500.0, 0.0)],
)
def test_peaks_are_those_of_all_targets(wild_motion, robot, loop, interval, rate, margin):
    """As they are clamped; some joints rest, some pass limits, some do not."""
    joints = wild_motion.joint_pos * np.linspace(0.0, 9.0, len(JOINT_NAMES))
    within = np.clip(joints, robot.lower - 5e-7, robot.upper + 5e-7)  # in six decimals
    joints[:, ::2] = within[:, ::2]
    trajectory = Trajectory(replace(wild_motion, joint_pos=joints), loop=loop)
    start, length = interval or (0.0, trajectory.period)
    times = start + np.arange(int(length * rate + 1e-6) + 1) / rate
    asked = trajectory.sample_many(times)
    limit, still = PositionLimit(robot, margin), np.zeros(len(JOINT_NAMES))
    for target in asked.joint_pos:
        limit.apply(np.stack([target, still]), still)
    played = Interval(start, length, loop)
    report = measure_limits(trajectory, robot, played, rate=rate, position_margin=margin)
    speeds = {speed.joint: speed for speed in report.speeds}
    excess = margin + np.maximum(robot.lower - asked.joint_pos, asked.joint_pos - robot.upper)
    held = {joint.joint: joint for joint in report.held}
    assert 5 < len(held) < len(JOINT_NAMES)
    assert report.n_held == limit.clamped.sum()
    for j, name in enumerate(JOINT_NAMES):
        assert speeds[name].value == pytest.approx(np.abs(asked.joint_vel[:, j]).max(), rel=1e-9)
        assert (
            speeds[name].count == (np.abs(asked.joint_vel[:, j]) > robot.velocity[j] + 1e-6).sum()
        )
        assert (name in held) == (excess[:, j].max() > POSITION_TOLERANCE)
        if name in held:
            assert held[name].count == limit.clamped[j]
            assert abs(held[name].value - held[name].limit) == pytest.approx(excess[:, j].max())


def test_the_frames_of_an_interval_are_those_between_which_it_is_interpolated(wild_motion):
    """0.58 * 50 is a little less than 29, and 0.14 * 50 a little more than 7."""
    fps = wild_motion.fps
    for first, last in ((0, 7), (29, 36), (1, wild_motion.n_frames - 1)):
        interval = Interval(first / fps, (last - first) / fps)
        assert interval.frames(wild_motion) == range(first, last + 1)
    between = Interval(1.5 / fps, 2.0 / fps)
    assert between.frames(wild_motion) == range(1, 5)
    endless = Interval(1.0, None, loop=True)
    assert endless.frames(wild_motion) == range(wild_motion.n_frames)
