"""What can be combined: one data file for the refusals and for the page."""

import pytest

from g1stream.config import StreamConfig, load_config
from g1stream.control.combinations import _ABOUT, combinations, require_combination
from g1stream.errors import ConfigError, SafetyError
from g1stream.robot.joints import JOINT_SETS
from g1stream.robot.model import G1


def test_the_tables_name_settings_and_kinds_that_exist():
    kinds = {one.name for one in JOINT_SETS}
    for receivers in combinations().values():
        for about in receivers.values():
            assert about.keys() - _ABOUT <= StreamConfig.model_fields.keys()
            assert set(about["kinds"]) <= kinds
            assert isinstance(about["network"], bool)


@pytest.mark.parametrize(
    ("over", "robot", "simulated", "refused"),
    [
        ({}, "g1_dual_arm", False, None),
        ({"stream.joints": "left_arm", "stream.via": "arm_sdk"}, "g1_23dof", False, None),
        ({"stream.via": "arm_sdk", "stream.joints": "legs"}, None, True, ConfigError),
        ({"stream.via": "arm_sdk"}, "g1_dual_arm", True, ConfigError),
        ({"stream.support": "feet"}, None, True, None),
        ({"stream.support": "feet"}, None, False, SafetyError),
        ({"stream.support": "feet", "profile": "network-simulator"}, None, False, None),
        ({"stream.support": "feet", "profile": "robot"}, None, False, SafetyError),
        ({"stream.policy": "p.onnx", "profile": "network-simulator"}, None, False, None),
        ({"stream.policy": "p.onnx", "profile": "robot"}, None, False, SafetyError),
        ({"stream.support": "feet", "stream.loop": True}, None, True, ConfigError),
        ({"stream.support": "feet", "stream.via": "arm_sdk"}, None, True, ConfigError),
        ({"stream.support": "feet"}, "g1_23dof", True, ConfigError),
        ({"stream.policy": "p.onnx", "stream.support": "free"}, None, True, None),
        ({"stream.policy": "p.onnx", "stream.support": "feet"}, None, True, ConfigError),
        ({"stream.policy": "p.onnx", "gains.kp": {"*": 20.0}}, None, True, ConfigError),
    ],
)
def test_what_is_not_in_the_tables_is_refused(over, robot, simulated, refused):
    config, robot = load_config(over=over), G1.load(robot)
    if refused is None:
        require_combination(config, robot, simulated=simulated)
        return
    with pytest.raises(refused):
        require_combination(config, robot, simulated=simulated)
