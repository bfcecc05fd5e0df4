"""The motion service and onboard controller of the simulated robot, for the bridge.

A real robot walks and stands with its own controller, which publishes LowCmd until the motion
service releases it. Here the controller holds the pose in which it was started. It does not fall,
because the base is scripted; if the support follows a reference, the base sways like a standing
robot. The controller blends commands from rt/arm_sdk into its own for arms and waist, with the
weight in them.
"""

from __future__ import annotations

import json
import logging
from math import cos, pi, sin
from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np

from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LowCmd, LowState
from g1stream.extras.onboard.motion_service import (
    API_VERSION,
    ApiEndpoint,
    ApiId,
    ErrorCode,
    response_to,
)
from g1stream.extras.onboard.receiver import OnboardController
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP
from g1stream.sim.world import Root
from g1stream.types import OnboardMode

if TYPE_CHECKING:
    from g1stream.dds.domain import Participant

__all__ = ["MotionService"]

_LOGGER = logging.getLogger(__name__)

_FORM: Final = "0"  # without wheels
#: Height of the base, m, and amplitude, m, and frequency, Hz, of its sway to both sides.
_HEIGHT: Final = 0.79
_SWAY: Final = 0.005
_SWAYS: Final = 0.4
#: Factors of kp and kd over Unitree's example, with whose gains the waist would sag by 14 degrees.
_STIFFER: Final = (5.0, 2.0)
#: Weight up to which the arms count as handed back; the example of Unitree's SDK ends with 0.007.
_LEAST: Final = 0.01


class MotionService:
    """Serves MotionSwitcher; while a mode is active, publishes LowCmds that hold the pose.

    While a mode is active, it also subscribes to rt/arm_sdk. As on the robot, a received weight
    stays in force until the next one.

    Args:
        participant: the participant of the bridge.
        mode: mode that is active at the start; None: no mode.
    """

    def __init__(self, participant: Participant, mode: OnboardMode | None = None) -> None:
        self._participant = participant
        self._calls = ApiEndpoint(participant, serves=True)
        self._mode = ""
        self._writer: RawWriter | None = None
        self._arms: RawReader | None = None
        self._command: LowCmd | None = None
        self._asked = LowCmd()
        self._started: int | None = None
        if mode:
            self._select(mode)

    def step(self, low_state: bytes, stamp: int) -> None:
        """Answer calls, and publish the command of the active mode.

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
            self._take_arms()
            self._writer.write(_blended(self._command, self._asked), stamp)

    def stance(self, now: int) -> Root | None:
        """Base pose at `now`, ns, of a robot that its controller balances; None without a mode."""
        if not self._writer:
            return None
        self._started = now if self._started is None else self._started
        angle = 2.0 * pi * _SWAYS * (now - self._started) / 1e9
        return Root(
            np.array([0.0, _SWAY * sin(angle), _HEIGHT]),
            np.array([1.0, 0.0, 0.0, 0.0]),
            np.array([0.0, _SWAY * 2.0 * pi * _SWAYS * cos(angle), 0.0]),
            np.zeros(3),
            playing=False,
        )

    def _take_arms(self) -> None:
        """Take the newest valid command on rt/arm_sdk; its mode_machine is not checked."""
        sample = self._arms.take_latest() if self._arms else None
        if sample is None:
            return
        command = LowCmd()
        command.load(sample.data)
        values = (command.q, command.dq, command.tau, command.kp, command.kd, command.weight)
        if not command.crc_matches():
            _LOGGER.warning("command on %s refused: its CRC is wrong", OnboardController.topic.name)
        elif not all(np.isfinite(one).all() for one in values):
            _LOGGER.warning(
                "command on %s refused: a value is not finite", OnboardController.topic.name
            )
        else:
            moved = command.weight > _LEAST
            if moved != (self._asked.weight > _LEAST):
                how = "moved from" if moved else "handed back by"
                _LOGGER.info("arms and waist are %s %s", how, OnboardController.topic.name)
            self._asked = command

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
            self._arms = RawReader(self._participant, OnboardController.topic)
            _LOGGER.info("motion service: mode %s is active and publishes LowCmd", name)
        return ErrorCode.DONE

    def _release(self) -> None:
        if self._writer:
            _LOGGER.info("motion service: mode %s is released", self._mode)
            self._writer.close()
        if self._arms:
            self._arms.close()
        self._mode, self._writer, self._arms, self._command = "", None, None, None
        self._asked, self._started = LowCmd(), None


def _name_in(parameter: str) -> Any:
    """The name in the parameter of SelectMode; None without a name."""
    try:
        return json.loads(parameter).get("name")
    except (ValueError, AttributeError, RecursionError):
        return None


def _hold(low_state: bytes) -> LowCmd:
    """Make a LowCmd that holds the pose of a LowState."""
    state, command = LowState(), LowCmd()
    state.load(low_state)
    command.motor_mode = 1
    command.mode_machine[()] = state.mode_machine
    command.q[:] = state.q
    command.kp[:], command.kd[:] = _STIFFER[0] * EXAMPLE_KP, _STIFFER[1] * EXAMPLE_KD
    return command


def _blended(own: LowCmd, asked: LowCmd) -> bytes:
    """Blend the command `asked` for arms and waist into the controller's own, by its weight."""
    command, weight = LowCmd(), float(np.clip(asked.weight, 0.0, 1.0))
    command.load(own.tobytes())
    for name in ("q", "dq", "tau", "kp", "kd"):
        values, others = getattr(command, name), getattr(asked, name)
        values[OnboardController.joints] += weight * (
            others[OnboardController.joints] - values[OnboardController.joints]
        )
    return command.seal()
