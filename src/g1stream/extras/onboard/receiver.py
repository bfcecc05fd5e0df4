"""The robot's own controller as the receiver of commands for arms and waist, on rt/arm_sdk.

It blends the targets into its own while it stands, walks and balances, with a weight w from 0 to 1:
the motors get (1 - w) of the controller's command and w of the stream's. It keeps the last weight
that any program sent, so the program that raised it must bring it back to 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from g1stream.control.receiver import SERVICE_TIMEOUT, Receiver
from g1stream.dds.messages import COMMANDS
from g1stream.errors import SafetyError, WireError
from g1stream.robot.joints import select_joints
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from g1stream.config import StreamConfig
    from g1stream.dds.domain import Participant
    from g1stream.dds.messages import LowCmd

__all__ = ["OnboardController"]

#: Time in which the weight goes from 0 to 1 or back, s, as in Unitree's examples.
_WEIGHT_TIME: Final = 2.0
#: Time in which arms and waist are handed back at the end, s. The weight of 0 is repeated, because
#: a best-effort reader may miss one command.
_HAND_BACK_TIME: Final = _WEIGHT_TIME + 0.05


class OnboardController(Receiver):
    """Gives targets to arms and waist, with a weight.

    The weight rises from the first command on, and falls in DAMP. There, arms and waist keep gains
    and torque of the last target, without its velocity, while the controller takes them over.
    """

    topic = COMMANDS["arm_sdk"]
    joints = select_joints("arms,waist")
    carries = True
    ending = "hands arms and waist back"
    source = "g1stream.extras.onboard.source:CarriedTorques"
    # The controller is not released, because it carries the robot while a stream moves its arms.
    end_other = "Stop it, because only one program at a time can move the arms."

    def __init__(self, period: int, damp: float) -> None:
        super().__init__(period, max(damp, _HAND_BACK_TIME))
        self._sent, self._tick = 0.0, 0  # weight of the last command, and the tick after it
        self._next = 0.0

    def timing(self, settings: StreamConfig) -> dict[str, Any]:
        return {"ramp": max(settings.ramp, _WEIGHT_TIME), "damp": _HAND_BACK_TIME}

    def check(self, participant: Participant) -> tuple[str, str]:
        """Check that a mode is active, without which nothing would move.

        Raises:
            SafetyError: no mode is active.
        """
        from g1stream.extras.onboard.motion_service import MotionSwitcherClient  # for DDS

        try:
            active = MotionSwitcherClient(participant, SERVICE_TIMEOUT).check().name
        except WireError as error:
            return (
                f"{error.cause} The robot's own controller may not be active.",
                "Continue only if you know that the robot's controller balances it.",
            )
        if not active:
            raise SafetyError(
                "rt/arm_sdk needs the robot's own controller, which is not active: nothing would "
                "move.",
                "Activate it with the remote or g1stream robot restore ai "
                f"--domain {participant.domain} --interface {participant.interface}; in the "
                "simulator use g1stream sim --onboard ai.",
            )
        return f"mode {active} is active, and forwards the arm commands", ""

    def damp(self, command: LowCmd) -> None:
        """Stop with the same gains and torque; `seal` reduces the weight."""
        command.dq[:] = 0.0

    def seal(self, command: LowCmd, phase: Phase, tick: int) -> bytes:
        if tick != self._tick:  # the command of the previous tick has been sent
            self._sent, self._tick = self._next, tick
        step = self._period / 1e9 / _WEIGHT_TIME
        moved = self._sent + (step if phase is not Phase.DAMP else -step)
        command.weight[()] = self._next = min(1.0, max(0.0, moved))  # 0 after NaN
        return command.seal()

    def end(self, command: LowCmd) -> Iterator[bytes]:
        self.damp(command)
        self._next = float(command.weight)
        for tick in range(1, self._ending_commands + 1):
            yield self.seal(command, Phase.DAMP, tick)
