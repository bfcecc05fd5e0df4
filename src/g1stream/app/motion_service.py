"""Show, release and restore the mode of the robot's motion service."""

from __future__ import annotations

import json
import logging
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from g1stream.dds.domain import Participant, network_name
from g1stream.dds.messages import LOWCMD
from g1stream.dds.motion_switcher import MotionSwitcherClient
from g1stream.errors import ConfigError, G1StreamError, SafetyError
from g1stream.files import complete_file

if TYPE_CHECKING:
    from g1stream.config import DdsConfig
    from g1stream.dds.motion_switcher import OnboardStatus

__all__ = ["onboard_status", "release_mode", "restore_mode"]

_LOGGER = logging.getLogger(__name__)


def onboard_status(where: DdsConfig, timeout: float = 5.0) -> OnboardStatus:
    """The form of the robot and the mode that is active.

    Args:
        where: the robot's domain and interface.
        timeout: the longest wait for an answer, s.

    Raises:
        WireError: there is no motion service, or it does not answer as it should.
    """
    with Participant(where.domain, where.interface) as participant:
        return MotionSwitcherClient(participant, timeout).check()


def release_mode(where: DdsConfig, timeout: float = 5.0) -> str:
    """Release the active mode, upon which the robot goes limp, and remember it for `restore_mode`.

    Returns:
        The mode that was active; empty where none was, and nothing was done.

    Raises:
        WireError: there is no motion service, or it does not answer as it should.
    """
    with Participant(where.domain, where.interface) as participant:
        client = MotionSwitcherClient(participant, timeout)
        name = client.check().name
        if name:
            _remember(where, name)  # first, so that an interruption does not lose it
            client.release()
    return name


def restore_mode(where: DdsConfig, name: str | None = None, timeout: float = 5.0) -> str:
    """Start a mode; by default the one that `release_mode` released last.

    Returns:
        The mode that is active now.

    Raises:
        ConfigError: no name is given, and none is remembered.
        SafetyError: another program publishes LowCmd.
        WireError: there is no motion service, it has no such mode, or does not answer as it should.
    """
    name = name or _remembered(where)
    with Participant(where.domain, where.interface) as participant:
        client = MotionSwitcherClient(participant, timeout)
        active = client.check().name
        if not active and (others := participant.commanders()):
            raise SafetyError(
                f"There is a publisher on {LOWCMD.name}, which the mode {name} would fight: "
                f"{', '.join(map(participant.owner, others))}.",
                "Stop it first.",
            )
        if active != name:
            client.select(name)
    return name


def _released_file() -> Path:
    """Which mode was released where; in the user's state directory (XDG Base Directory)."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "g1stream" / "released-modes.json"


def _place(where: DdsConfig) -> str:
    return f"domain {where.domain} on {network_name(where.interface)}"


def _read_released() -> dict[str, str]:
    with suppress(OSError, ValueError):
        values = json.loads(_released_file().read_text())
        if isinstance(values, dict):
            return {str(place): str(name) for place, name in values.items()}
    return {}


def _remember(where: DdsConfig, name: str) -> None:
    file = _released_file()
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with complete_file(file) as temporary:
            temporary.write_text(json.dumps(_read_released() | {_place(where): name}))
    except (OSError, G1StreamError) as error:
        _LOGGER.warning("the released mode %s cannot be kept in %s: %s", name, file, error)


def _remembered(where: DdsConfig) -> str:
    name = _read_released().get(_place(where))
    if name is None:
        raise ConfigError(
            f"No mode is known that was released in {_place(where)}.",
            "Name the mode to restore: g1stream robot restore ai.",
        )
    return name
