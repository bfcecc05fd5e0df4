"""Targets for arms and waist on rt/arm_sdk, which the robot's own controller blends into its own.

The controller stands, walks and balances meanwhile. A weight w from 0 to 1 says how much of arms
and waist is ours: the motors get (1 - w) of its command and w of ours. It keeps the last weight
that it was sent, whoever sent it, so that whoever raised it has to bring it back to 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.control.commands import CommandLimits, Composer
from g1stream.dds.messages import LowCmd
from g1stream.errors import ConfigError
from g1stream.robot.joints import select_joints
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from g1stream.config import StreamConfig
    from g1stream.control.gains import Gains

__all__ = ["MOVED", "ArmSdkComposer", "hand_back_commands", "settings_for_arm_sdk"]

#: The weight goes from 0 to 1, and back, in this time, s, as in Unitree's examples.
_WEIGHT_TIME: Final = 2.0
#: How long arms and waist are handed back at the end, s; at last a weight of 0 is repeated, because
#: a best-effort reader may miss one.
_HAND_BACK_TIME: Final = _WEIGHT_TIME + 0.05

MOVED: Final = select_joints("arms,waist")
"""(29,) the joints that the controller lets others move."""


def settings_for_arm_sdk(settings: StreamConfig) -> StreamConfig:
    """The settings of a stream with `via` = arm_sdk, with those that depend on it set.

    Raises:
        ConfigError: they ask for what the controller does not let others do.
    """
    if (select_joints(settings.played_joints) & ~MOVED).any():
        raise ConfigError(
            f"stream.joints = {settings.joints!r} selects joints of the legs, which stream.via = "
            "arm_sdk cannot move.",
            "Choose of arms and waist, or leave --via out.",
        )
    if settings.others == "free":
        raise ConfigError(
            "stream.others = free with stream.via = arm_sdk: nothing would carry these joints.",
            "Leave --others out: arms and waist that do not play then hold their pose.",
        )
    if settings.support:
        raise ConfigError(
            f"stream.support = {settings.support} with stream.via = arm_sdk: the robot's own "
            "controller carries it.",
            "Leave --support out.",
        )
    return settings.model_copy(
        update={
            "ramp": max(settings.ramp, _WEIGHT_TIME),
            "damp": _HAND_BACK_TIME,
            "soft_start": 0.0,
        }
    )


class ArmSdkComposer(Composer):
    """Makes commands for rt/arm_sdk: only arms and waist, and a weight.

    The weight rises from the first command on, and falls in DAMP; there, arms and waist keep gains
    and torque of the last target, without its velocity, while the controller takes them over.

    Args:
        limits, gains, played, commanded: as of `Composer`.
        period: ns between commands.
    """

    def __init__(
        self,
        limits: CommandLimits,
        gains: Gains,
        played: NDArray[np.bool_],
        commanded: NDArray[np.bool_],
        period: int,
    ) -> None:
        super().__init__(limits, gains, 0.0, played, commanded)
        self._weight = self._next_weight = 0.0
        self._period = period

    def damp(self) -> None:
        """Come to rest: gains and torque stay, see `_seal`."""
        self._command.dq[:] = 0.0

    def sent(self) -> None:
        super().sent()
        self._weight = self._next_weight

    def _seal(self, phase: Phase) -> bytes:
        self._next_weight = _next_weight(self._weight, self._period, up=phase is not Phase.DAMP)
        self._command.weight[()] = self._next_weight
        return super()._seal(phase)


def hand_back_commands(command: bytes, period: int) -> Iterator[bytes]:
    """Sealed commands, `period` ns apart, that bring the weight of `command` to 0.

    Its targets, gains and torques stay, without velocity.
    """
    last = LowCmd()
    last.load(command)
    last.dq[:] = 0.0
    weight = float(last.weight)
    for _ in range(round(_HAND_BACK_TIME * 1e9 / period) + 1):
        last.weight[()] = weight = _next_weight(weight, period, up=False)
        yield last.seal()


def _next_weight(weight: float, period: int, *, up: bool) -> float:
    """The weight of the command that is `period` ns later; of NaN it is 0."""
    step = period / 1e9 / _WEIGHT_TIME
    return min(1.0, max(0.0, weight + (step if up else -step)))
