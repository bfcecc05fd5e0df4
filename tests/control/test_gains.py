"""Gains: patterns over the gains of Unitree's example."""

import pytest

from g1stream.config import GainsConfig, load_config
from g1stream.control.gains import gains_in_play, resolve_gains
from g1stream.errors import ConfigError
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES
from g1stream.robot.model import G1


def test_defaults_are_the_example():
    gains = resolve_gains(GainsConfig())
    assert gains.kp.tolist() == EXAMPLE_KP.tolist()
    assert gains.kd.tolist() == EXAMPLE_KD.tolist()


def test_a_pattern_sets_all_matching_joints():
    gains = resolve_gains(GainsConfig(kd={"*_knee_joint": 4.0, "waist_*": 2.5}))
    for i, name in enumerate(JOINT_NAMES):
        expected = {"knee": 4.0, "waist": 2.5}
        wanted = [value for part, value in expected.items() if part in name]
        assert gains.kd[i] == (wanted[0] if wanted else EXAMPLE_KD[i])


def test_later_patterns_override_earlier_ones():
    gains = resolve_gains(GainsConfig(kp={"*": 10.0, "left_*": 20.0, "left_elbow_joint": 30.0}))
    for i, name in enumerate(JOINT_NAMES):
        side = 20.0 if name.startswith("left_") else 10.0
        assert gains.kp[i] == (30.0 if name == "left_elbow_joint" else side)


def test_the_defaults_are_not_modified():
    resolve_gains(GainsConfig(kp={"*": 1.0})).kd[:] = 0.0
    assert resolve_gains(GainsConfig()).kd.tolist() == EXAMPLE_KD.tolist()


@pytest.mark.parametrize("table", ["kp", "kd"])
@pytest.mark.parametrize("pattern", ["Left_Knee_Joint", "left_knee_joint ", "*_toe_joint", "xyz"])
def test_a_pattern_that_matches_no_joint_is_named_with_close_matches(table, pattern):
    with pytest.raises(ConfigError) as caught:
        resolve_gains(GainsConfig(**{table: {pattern: 1.0}}))
    assert repr(pattern) in caught.value.cause
    assert table in caught.value.cause
    assert "left_knee" in caught.value.remedy


def test_joints_that_are_free_have_their_damping_only():
    over = {"stream.joints": "legs", "stream.others": "free", "gains.kd": {"waist": 2.0}}
    gains = gains_in_play(load_config(over=over), G1.default())
    assert gains.kp.tolist() == [*EXAMPLE_KP[:12], *[0.0] * 17]
    assert gains.kd.tolist() == [*EXAMPLE_KD[:12], *[2.0] * 3, *EXAMPLE_KD[15:]]
    held = gains_in_play(load_config(over={"stream.joints": "legs"}), G1.default())
    assert held.kp.tolist() == EXAMPLE_KP.tolist()
