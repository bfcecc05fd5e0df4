"""What receives the commands: the motors, or what a row of `RECEIVERS` names."""

from __future__ import annotations

from itertools import repeat
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.dds.messages import LOWCMD, LowCmd, Topic
from g1stream.errors import SafetyError, WireError
from g1stream.optional import extension, load_object
from g1stream.robot.joints import N_JOINTS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from g1stream.config import StreamConfig
    from g1stream.dds.domain import Participant
    from g1stream.types import Phase, Via

__all__ = ["SERVICE_TIMEOUT", "Receiver", "load_receiver"]

RECEIVERS: Final[Mapping[Via, str]] = {
    "lowcmd": "g1stream.control.receiver:Receiver",
    "arm_sdk": "g1stream.extras.onboard.receiver:OnboardController",
}
"""Receivers as `module:class`, by `stream.via`. To add one, add a row."""

SERVICE_TIMEOUT: Final = 3.0
"""Longest wait for the motion service, including discovery, s."""

#: kd of every joint while damping, N·m·s/rad.
_DAMP_KD: Final = 3.0


class Receiver:
    """The motors; a class that is derived from it is another receiver.

    The loop has one, and the guard process another one of the same class.

    Args:
        period: time between commands, ns.
        damp: duration of DAMP, s.

    Attributes:
        topic: topic of the commands.
        joints: (29,) the joints that are commanded, if the robot has them.
        carries: the robot's own controller keeps the robot on its feet meanwhile.
        ending: what DAMP does, as a verb for log messages.
        source: the source for a motion, as in `SOURCES` of `control.sources`; None: that of a held
            robot.
        end_other: what to do about another publisher of commands.
    """

    topic: Topic = LOWCMD
    joints: NDArray[np.bool_] = np.ones(N_JOINTS, np.bool_)
    carries: bool = False
    ending: str = "damps"
    source: str | None = None
    end_other: str = "Stop it; `g1stream robot release` releases the robot's own controller."

    def __init__(self, period: int, damp: float) -> None:
        self._period = period
        self._ending_commands = -(-round(damp * 1e9) // period) + 1

    def timing(self, settings: StreamConfig) -> dict[str, Any]:
        """The settings of `[stream]` that this receiver changes, by name."""
        return {}

    def check(self, participant: Participant) -> tuple[str, str]:
        """Check before the first command that the robot's own controller sends none.

        Returns:
            What was found, and what to do if it is not certain; otherwise "".

        Raises:
            SafetyError: it is active.
        """
        try:
            active = extension("motion_service")(participant, SERVICE_TIMEOUT).check().name
        except WireError as error:  # a simulator has no motion service; publishers are checked
            return (
                f"{error.cause} The robot's own controller may be active, and its commands would "
                "conflict with ours.",
                "Continue only if this is a simulator, or if you know that no mode is active.",
            )
        if active:
            raise SafetyError(
                f"The robot's own controller is active (mode {active}). Its commands would "
                "conflict with ours.",
                "Support the robot, because it will go limp, and run: g1stream robot release "
                f"--domain {participant.domain} --interface {participant.interface}",
            )
        return "no mode is active", ""

    def damp(self, command: LowCmd) -> None:
        """Change a command to one of DAMP: only damping, without position control."""
        command.kp[:] = command.dq[:] = command.tau[:] = 0.0
        command.kd[:] = _DAMP_KD * (command.motor_mode == 1)  # 0 for missing motors

    def seal(self, command: LowCmd, phase: Phase, tick: int) -> bytes:
        """The bytes of a command, with its CRC.

        Args:
            command: the command.
            phase: phase of the session.
            tick: number of the command; it repeats if the last command was not sent.
        """
        return command.seal()

    def end(self, command: LowCmd) -> Iterator[bytes]:
        """The guard's commands after `command`, the last one of a stream, `period` ns apart."""
        self.damp(command)
        return repeat(command.seal(), self._ending_commands)


def load_receiver(via: Via, period: int, damp: float) -> Receiver:
    """Make the receiver `via`; other arguments as of `Receiver`.

    Raises:
        ConfigError: a package that the receiver needs is not installed.
    """
    made: Receiver = load_object(RECEIVERS[via])(period, damp)
    return made
