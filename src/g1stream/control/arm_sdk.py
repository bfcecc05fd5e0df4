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

    from g1stream.control.gains import Gains

__all__ = ["HAND_BACK_TIME", "MOVED", "WEIGHT_TIME", "ArmSdkComposer", "hand_back_commands"]

WEIGHT_TIME: Final = 2.0
"""The weight goes from 0 to 1, and back, in this time, s, as in Unitree's examples."""

_LAST: Final = 0.05
"""For so long, s, a weight of 0 is repeated: a best-effort reader may miss one."""

HAND_BACK_TIME: Final = WEIGHT_TIME + _LAST
"""How long arms and waist are handed back at the end, s."""

MOVED: Final = select_joints("arms,waist")
"""(29,) the joints that the controller lets others move."""


class ArmSdkComposer(Composer):
    """Makes commands for rt/arm_sdk: only arms and waist, and a weight.

    The weight rises from the first command on, and falls in DAMP; there, arms and waist keep their
    gains at the last target, without velocity and torque, while the controller takes them over.

    Args:
        limits, gains, played, commanded: as of `Composer`.
        period: ns between commands.

    Raises:
        ConfigError: a joint that is played is of a leg.
    """

    def __init__(
        self,
        limits: CommandLimits,
        gains: Gains,
        played: NDArray[np.bool_],
        commanded: NDArray[np.bool_],
        period: int,
    ) -> None:
        if (played & ~MOVED).any():
            raise ConfigError(
                "stream.joints names joints of the legs, which stream.via = arm_sdk cannot move.",
                "Choose of arms and waist, or leave --via out.",
            )
        super().__init__(limits, gains, 0.0, played, commanded)
        self._weight = self._next_weight = 0.0
        self._step = period / 1e9 / WEIGHT_TIME

    def damp(self) -> None:
        """The gains stay: see `_seal`."""

    def sent(self) -> None:
        super().sent()
        self._weight = self._next_weight

    def _seal(self, phase: Phase) -> bytes:
        step = -self._step if phase is Phase.DAMP else self._step
        self._next_weight = min(1.0, max(0.0, self._weight + step))
        self._command.weight[()] = self._next_weight
        return super()._seal(phase)


def hand_back_commands(command: bytes, period: int) -> Iterator[bytes]:
    """Sealed commands, `period` ns apart, that bring the weight of `command` to 0.

    Its targets stay, without velocity and torque.
    """
    last = LowCmd()
    last.load(command)
    last.dq[:] = last.tau[:] = 0.0
    weight = min(1.0, max(0.0, float(last.weight)))
    for _ in range(round(HAND_BACK_TIME * 1e9 / period) + 1):
        weight = max(0.0, weight - period / 1e9 / WEIGHT_TIME)
        last.weight[()] = weight
        yield last.seal()
