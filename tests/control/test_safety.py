"""In which order the checks of a session count."""

import numpy as np
import pytest

from g1stream.config import SafetyConfig
from g1stream.control.safety import Safety
from g1stream.dds.messages import LowState
from g1stream.errors import ConfigError

NOW = 5_000_000_000


@pytest.fixture
def make(robot):
    return lambda **settings: Safety(robot, SafetyConfig(**settings))


@pytest.fixture
def calm():
    state = LowState()
    state.quaternion[0] = 1.0
    state.mode_machine[()] = 5
    return state


def test_all_is_well(make, calm):
    safety = make()
    assert safety.take(calm, 1, NOW).received == NOW
    assert safety.unknown(NOW) == safety.missing() == safety.verdict() == ""


def test_what_is_not_believed_is_not_judged(make, calm):
    safety = make()
    calm.dq[3] = 1000.0
    calm.q[3] = np.nan
    safety.take(calm, 1, NOW)
    assert "NaN" in safety.unknown(NOW)
    assert safety.verdict() == ""


def test_the_remote_counts_from_the_first_command_on(make, calm):
    safety = make(deadman="R1")
    calm.wireless_remote[2:4] = (0x20, 0x02)
    safety.take(calm, 1, NOW)
    assert "safety.deadman" in safety.missing()
    assert safety.verdict() == ""
    safety.begin()
    safety.take(calm, 1, NOW)
    assert safety.verdict().startswith("L2+B was pressed")


def test_an_unknown_button_is_refused(make):
    with pytest.raises(ConfigError, match=r"safety\.stop_buttons"):
        make(stop_buttons=["L3"])
