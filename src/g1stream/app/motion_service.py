"""Show, release and restore the mode of the robot's motion service."""

from __future__ import annotations

from g1stream.config import DdsConfig
from g1stream.dds.domain import Participant
from g1stream.dds.messages import LOWCMD
from g1stream.dds.motion_switcher import MotionSwitcherClient, OnboardStatus
from g1stream.errors import SafetyError


def onboard_status(where: DdsConfig, timeout: float = 5.0) -> OnboardStatus:
    """The form of the robot and its active mode."""
    with Participant(where.domain, where.interface) as participant:
        return MotionSwitcherClient(participant, timeout).check()


def release_mode(where: DdsConfig, timeout: float = 5.0) -> str:
    """Release the active mode, upon which the robot goes limp. Returns its name; "" if none."""
    with Participant(where.domain, where.interface) as participant:
        client = MotionSwitcherClient(participant, timeout)
        name = client.check().name
        if name:
            client.release()
    return name


def restore_mode(where: DdsConfig, name: str, timeout: float = 5.0) -> None:
    """Start a mode, unless another program publishes LowCmd."""
    with Participant(where.domain, where.interface) as participant:
        client = MotionSwitcherClient(participant, timeout)
        active = client.check().name
        if not active and (others := participant.commanders()):
            raise SafetyError(
                f"The mode {name} would conflict with a publisher on {LOWCMD.name}: "
                f"{', '.join(map(participant.owner, others))}.",
                "Stop it first.",
            )
        if active != name:
            client.select(name)
