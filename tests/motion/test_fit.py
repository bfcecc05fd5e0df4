from dataclasses import replace

import numpy as np
import pytest

from g1stream.config import load_config
from g1stream.errors import ConfigError, MotionError, SafetyError
from g1stream.motion.fit import fit_to_robot
from g1stream.motion.readers import load_motion
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.model import G1, VARIANTS

ROBOT = G1.default()
KNEE = JOINT_NAMES.index("left_knee_joint")


@pytest.fixture(scope="module")
def demo():
    return load_motion("demo")


def with_knee(motion, frames, change):
    joints = motion.joint_pos.copy()
    joints[frames, KNEE] = np.clip(joints[frames, KNEE] + change, 0.0, 2.8)
    return replace(motion, joint_pos=joints)


def fitted(motion, simulated=True, **settings):
    over = {f"stream.{name}": value for name, value in settings.items()}
    config = load_config(over=over)
    played = ROBOT.select(config.stream.played_joints)
    return fit_to_robot(motion, ROBOT, config, played, simulated=simulated)


@pytest.mark.parametrize("loop", [False, True])
def test_the_demo_is_played_as_it_is(demo, loop):
    playable = fitted(demo, loop=loop)
    assert playable.trajectory.motion is demo
    assert playable.trajectory.loop is loop
    assert playable.slowed == 1.0


@pytest.mark.parametrize(
    ("change", "looks"),
    [
        (lambda m: with_knee(m, slice(100, 101), 2.4), "frame 100 were a spike"),
        (lambda m: with_knee(m, slice(200, None), 1.0), "joined: .* 199 to 200"),
        (lambda m: replace(m, fps=300.0), "left_knee_joint at .* rad/s"),
        (lambda m: replace(m, joint_pos=m.joint_pos + 1.5), "rad in frame"),
    ],
)
def test_a_motion_that_no_robot_should_play_is_refused(demo, change, looks):
    with pytest.raises(SafetyError, match=looks):
        fitted(change(demo))


def test_no_setting_plays_what_is_not_in_radians(demo):
    short = demo.frames(80, 120)
    joints = short.joint_pos.copy()
    joints[20, KNEE] = 9e8
    for angles in (joints, 50 * short.joint_pos):
        motion = replace(short, joint_pos=angles)
        for beyond in ("refuse", "scale-time", "clamp", "anyway"):
            with pytest.raises(MotionError, match="not in radians"):
                fitted(motion, beyond_limits=beyond)


def test_only_the_part_that_is_played_counts(demo):
    spike = with_knee(demo, slice(300, 301), 2.4)
    assert fitted(spike, duration=5.0).slowed == 1.0
    assert fitted(spike, start=11.0).slowed == 1.0
    with pytest.raises(SafetyError):
        fitted(spike, start=8.0)


@pytest.mark.parametrize("loop", [False, True])
def test_a_motion_is_slowed_evenly_until_it_fits(demo, loop):
    fast = replace(demo, fps=300.0)
    playable = fitted(fast, beyond_limits="scale-time", loop=loop)
    motion = playable.trajectory.motion
    assert motion.fps == fast.fps / playable.slowed
    assert motion.joint_pos.tolist() == fast.joint_pos.tolist()
    times = np.arange(0.0, motion.duration, 1e-3)
    share = np.abs(playable.trajectory.sample_many(times).joint_vel) / ROBOT.velocity
    assert 0.99 < share.max() <= 1.0
    assert playable.events[0][1].startswith("demo")
    assert fitted(motion).slowed == 1.0


def test_slowing_moves_no_joint_within_its_position_limit(demo):
    with pytest.raises(SafetyError, match="rad in frame"):
        fitted(replace(demo, joint_pos=demo.joint_pos + 1.5), beyond_limits="scale-time")


def test_anyway_is_for_a_simulator_only(demo):
    fast = replace(demo, fps=300.0)
    assert fitted(fast, beyond_limits="anyway").trajectory.motion is fast
    with pytest.raises(ConfigError, match="anyway"):
        fitted(fast, simulated=False, beyond_limits="anyway")
    assert fitted(fast, simulated=False, beyond_limits="clamp").trajectory.motion is fast


def test_joints_that_are_not_played_may_be_beyond_their_limits(demo):
    wild = with_knee(demo, slice(10, 11), 2.4)
    with pytest.raises(SafetyError):
        fitted(wild)
    with pytest.raises(SafetyError):
        fitted(wild, joints="legs")
    assert fitted(wild, joints="arms").trajectory.motion is wild


@pytest.mark.parametrize("name", VARIANTS)
def test_every_kind_of_g1_plays_the_demo(demo, name):
    """One has no joints at its feet, of which the floor's height would be told."""
    robot = G1.load(name)
    playable = fit_to_robot(demo, robot, load_config(), robot.present, simulated=True)
    assert playable.trajectory.motion is demo


def test_an_empty_selection_is_not_all_joints(demo):
    with pytest.raises(ConfigError, match="joints = ''"):
        fitted(demo, joints="")
