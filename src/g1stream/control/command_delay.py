"""Detect that commands take effect late, as in a simulator that queues them without CPU time.

Pure: times and measurements are arguments.
"""

from __future__ import annotations

import logging
from math import exp
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.dds.messages import LowCmd
from g1stream.robot.joints import N_JOINTS, TORQUE_LIMIT

if TYPE_CHECKING:
    from g1stream.control.reading import Reading

__all__ = ["DELAY_REMEDY", "CommandDelay"]

_LOGGER = logging.getLogger(__name__)

DELAY_REMEDY: Final = (
    "lower --rate (unitree_mujoco's Python simulator keeps up with 200), or give the simulator "
    "more CPU"
)
"""Remedy for commands that wait in a queue."""

#: Number of commands that are kept, the time between them, and between compared readings, s.
_KEPT: Final = 100
_STEP: Final = 0.02
_EVERY: Final = 0.05
#: Time constant of forgetting, s.
_MEMORY: Final = 1.0
#: Age up to which commands are not late, s.
_PROMPT: Final = 0.1
#: An older command is late if its squared torque error is below this fraction of the lowest one of
#: the newer commands. `_NOISE` is added to both errors for each reading, (N·m)².
_LEFT: Final = 0.25
_NOISE: Final = N_JOINTS * 0.05**2
#: Number of readings, with forgetting, before a delay is reported. Sensor noise changes the torques
#: from command to command, so one reading may match an old command by chance.
_ENOUGH: Final = 8.0


class CommandDelay:
    """Estimates the command delay from measured torques and the commands of the last two seconds.

    A motor's torque is tau + kp (q - measured q) + kd (dq - measured dq) within its limits, with
    the tau, q and dq of the command that it follows. The delay is the age of the command with the
    smallest squared torque error.

    Args:
        balanced: the motors balance the robot, which fails with a delay.

    Attributes:
        longest: longest delay so far, s; 0 if none was above 0.1 s, None in the first 2.5 s.
    """

    def __init__(self, *, balanced: bool = False) -> None:
        self.longest: float | None = None
        self._balanced = balanced
        self._seconds = 0.0
        self._command = LowCmd()
        self._kept, self._times = np.zeros((_KEPT, 5, N_JOINTS)), np.zeros(_KEPT)
        self._n = 0
        self._errors = np.zeros(_KEPT)
        self._noise = 0.0
        self._sent = self._compared = -np.inf
        self._content = b""

    def sent(self, time: float, command: bytes) -> None:
        """Add a LowCmd that was published at `time`, s."""
        if time - self._sent < _STEP - 1e-6:
            return
        self._sent = time
        self._command.load(command)
        one = self._command
        self._kept[self._n % _KEPT] = one.tau, one.q, one.dq, one.kp, one.kd
        self._times[self._n % _KEPT] = time
        self._n += 1

    def add(self, measured: Reading) -> None:
        """Compare a LowState; log a warning at the first delay."""
        time = measured.received / 1e9
        if time - self._compared < _EVERY - 1e-6 or self._n < _KEPT:
            return
        if measured.content == self._content:  # an unchanged state matches some old command
            return
        self._compared, self._content = time, measured.content
        newest_first = (self._n - 1 - np.arange(_KEPT)) % _KEPT
        ages = time - self._times[newest_first]
        prompt = ages < _PROMPT
        if not prompt.any():  # the loop stalled
            return
        tau, q, dq, kp, kd = self._kept[newest_first].transpose(1, 0, 2)
        asked = tau + kp * (q - measured.q) + kd * (dq - measured.dq)
        error = np.clip(asked, -TORQUE_LIMIT, TORQUE_LIMIT) - measured.tau
        kept = exp(-_EVERY / _MEMORY)
        self._errors = kept * self._errors + (error**2).sum(axis=1)
        self._noise = kept * self._noise + _NOISE
        if self._noise < _ENOUGH * _NOISE:
            return
        least = int(self._errors.argmin())
        least_prompt = self._errors[prompt].min()
        late = self._errors[least] + self._noise < _LEFT * (least_prompt + self._noise)
        self._seconds = float(ages[least]) if late else 0.0
        if late and not self.longest:
            _LOGGER.warning(
                "the motors follow commands that are %.2f s old; commands may wait in a queue: %s",
                self._seconds,
                DELAY_REMEDY,
            )
        self.longest = max(self.longest or 0.0, self._seconds)

    def stop_reason(self) -> str:
        """Why the robot has to be damped, or ""."""
        if not (self._balanced and self._seconds):
            return ""
        return f"the balance fails, because commands take effect {self._seconds:.2f} s late"
