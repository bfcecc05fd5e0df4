"""The robot's motion service and onboard controller, for the bridge.

A real robot walks and stands by a controller of its own, which publishes LowCmd until the motion
service releases it. Here the controller only holds the pose in which it was started.
"""

from __future__ import annotations

import json
import logging
from typing import TYPE_CHECKING, Any, Final, get_args

from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LowCmd, LowState
from g1stream.dds.motion_switcher import API_VERSION, ApiEndpoint, ApiId, ErrorCode, response_to
from g1stream.dds.topics import LOWCMD
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP
from g1stream.types import OnboardMode

if TYPE_CHECKING:
    from g1stream.dds.domain import Participant

__all__ = ["MotionService"]

_LOGGER = logging.getLogger(__name__)

_FORM: Final = "0"  # without wheels


class MotionService:
    """Serves MotionSwitcher; while a mode is active, publishes LowCmds that hold the pose.

    Args:
        participant: of the bridge.
        mode: active from the start; None: none is.
    """

    def __init__(self, participant: Participant, mode: OnboardMode | None = None) -> None:
        self._participant = participant
        self._calls = ApiEndpoint(participant, serves=True)
        self._mode = ""
        self._writer: RawWriter | None = None
        self._command: bytes | None = None
        if mode:
            self._select(mode)

    def step(self, low_state: bytes, stamp: int) -> None:
        """Answer what was called, and publish the command of the active mode.

        Args:
            low_state: the LowState that the robot has just published.
            stamp: its publish time, ns.
        """
        for request in self._calls.take():
            code, data = self._answer(request.header.identity.api_id, request.parameter)
            if not request.header.policy.noreply:
                self._calls.write(response_to(request, code, data))
        if self._writer:
            self._command = self._command or _hold(low_state)
            self._writer.write(self._command, stamp)

    def _answer(self, api: int, parameter: str) -> tuple[ErrorCode, str]:
        if api == ApiId.API_VERSION:
            return ErrorCode.DONE, API_VERSION
        if api == ApiId.CHECK_MODE:
            return ErrorCode.DONE, json.dumps({"form": _FORM, "name": self._mode})
        if api == ApiId.RELEASE_MODE:
            self._release()
            return ErrorCode.DONE, ""
        if api == ApiId.SELECT_MODE:
            return self._select(_name_in(parameter)), ""
        return ErrorCode.NOT_IMPLEMENTED, ""

    def _select(self, name: Any) -> ErrorCode:
        if not isinstance(name, str):
            return ErrorCode.PARAMETER
        if name not in get_args(OnboardMode):
            return ErrorCode.NAME
        if name != self._mode:
            self._release()
            self._mode = name
            self._writer = RawWriter(self._participant, LOWCMD)
            _LOGGER.info("motion service: mode %s is active and publishes LowCmd", name)
        return ErrorCode.DONE

    def _release(self) -> None:
        if self._writer:
            _LOGGER.info("motion service: mode %s is released", self._mode)
            self._writer.close()
        self._mode, self._writer, self._command = "", None, None


def _name_in(parameter: str) -> Any:
    """The name that SelectMode is given; None where there is none."""
    try:
        return json.loads(parameter).get("name")
    except (ValueError, AttributeError, RecursionError):
        return None


def _hold(low_state: bytes) -> bytes:
    """A LowCmd that holds the pose of a LowState, with the gains of Unitree's example."""
    state, command = LowState(), LowCmd()
    state.load(low_state)
    command.motor_mode = 1
    command.mode_machine[()] = state.mode_machine
    command.q[:] = state.q
    command.kp[:], command.kd[:] = EXAMPLE_KP, EXAMPLE_KD
    return command.seal()
