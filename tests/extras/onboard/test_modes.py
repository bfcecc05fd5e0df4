import pytest

from g1stream.config import DdsConfig
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWCMD
from g1stream.errors import SafetyError, WireError
from g1stream.extras.onboard.motion_service import (
    OnboardStatus,
    onboard_status,
    release_mode,
    restore_mode,
)


@pytest.fixture
def robot(bridge):
    with bridge("advanced") as where:
        yield where


def test_what_was_released_is_restored(robot):
    assert onboard_status(robot) == OnboardStatus(form="0", name="advanced")
    assert release_mode(robot) == "advanced"
    assert onboard_status(robot).name == ""
    assert release_mode(robot) == ""
    for mode in ("advanced", "normal"):
        restore_mode(robot, mode)
        assert onboard_status(robot).name == mode


def test_a_mode_is_not_restored_beside_a_publisher(robot, until):
    release_mode(robot)
    with Participant(robot.domain, "lo") as theirs:
        writer = RawWriter(theirs, LOWCMD)
        until(lambda: writer.matched, "the bridge")
        with pytest.raises(SafetyError):
            restore_mode(robot, "advanced")
    assert onboard_status(robot).name == ""


def test_without_a_service_there_is_no_status(domain_id):
    with pytest.raises(WireError):
        onboard_status(DdsConfig(domain=domain_id), 0.3)
