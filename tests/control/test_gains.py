import pytest

from g1stream.config import GainsConfig, load_config
from g1stream.control.gains import resolve_gains
from g1stream.control.plan import plan
from g1stream.errors import ConfigError
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES


def test_defaults_are_the_example():
    resolve_gains(GainsConfig(kp={"*": 1.0})).kd[:] = 0.0  # does not change them
    gains = resolve_gains(GainsConfig())
    assert gains.kp.tolist() == EXAMPLE_KP.tolist()
    assert gains.kd.tolist() == EXAMPLE_KD.tolist()


def test_a_pattern_sets_all_matching_joints_and_later_ones_override_earlier_ones():
    gains = resolve_gains(
        GainsConfig(kp={"*_knee_joint": 10.0, "left_*": 20.0, "left_elbow*": 30.0})
    )
    for name, kp, example in zip(JOINT_NAMES, gains.kp, EXAMPLE_KP, strict=True):
        side = 20.0 if name.startswith("left_") else 10.0 if "knee" in name else example
        assert kp == (30.0 if name == "left_elbow_joint" else side)


@pytest.mark.parametrize(
    ("table", "pattern"), [("kp", "Left_Knee_Joint"), ("kd", "left_knee_joint "), ("kp", "xyz")]
)
def test_a_pattern_that_matches_no_joint_is_named_with_close_matches(table, pattern):
    with pytest.raises(ConfigError) as caught:
        resolve_gains(GainsConfig(**{table: {pattern: 1.0}}))
    assert repr(pattern) in caught.value.cause
    assert table in caught.value.cause
    assert "left_knee" in caught.value.remedy


def test_joints_that_are_free_have_their_damping_only():
    over = {"stream.joints": "legs", "stream.others": "free", "gains.kd": {"waist": 2.0}}
    gains = plan("demo", load_config(over=over), simulated=True).gains
    assert gains.kp.tolist() == [*EXAMPLE_KP[:12], *[0.0] * 17]
    assert gains.kd.tolist() == [*EXAMPLE_KD[:12], *[2.0] * 3, *EXAMPLE_KD[15:]]
    held = plan("demo", load_config(over={"stream.joints": "legs"}), simulated=True).gains
    assert held.kp.tolist() == EXAMPLE_KP.tolist()
