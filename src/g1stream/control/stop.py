"""Why a session ends early: a kind, which programs read, and a text, which people read."""

from __future__ import annotations

from signal import SIGRTMIN, Signals
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from g1stream.types import StopKind

__all__ = ["REMEDIES", "Stop"]


class Stop(NamedTuple):
    """Why a session ends early.

    Attributes:
        kind: kind of the reason.
        text: the reason, without a full stop.
        signal: number of the signal that ended it; None for other kinds.
    """

    kind: StopKind
    text: str
    signal: int | None = None

    @classmethod
    def by_signal(cls, number: int) -> Stop:
        """The reason of a session that a signal ended; its text is the name of the signal."""
        try:
            name = Signals(number).name
        except ValueError:  # only the first and the last real-time signal have a name
            name = f"SIGRTMIN+{number - SIGRTMIN}"
        return cls("signal", name, number)


_LOOK: Final = "Look at this joint in the recording, and at the motion with `g1stream physics`."
REMEDIES: Final[dict[StopKind, str]] = {
    "state": "`g1stream doctor` looks for the cause; a simulator needs free CPUs.",
    "robot": "`g1stream doctor` tells what the robot reports; --robot names another kind of G1.",
    "tilt": "Set it up again, held: alone it falls, unless the stream keeps it upright "
    "(`g1stream stream --help`). For one that only swings, raise safety.max_tilt.",
    "speed": _LOOK,
    "torque": _LOOK,
    "tracking": "Check the gains, and the motion with `g1stream physics`.",
    "jam": "Check the joint's kp, that the joint is free, and that its motor is on.",
    "motor": "Switch the robot off and on; Unitree's app shows the state of its motors.",
    "temperature": "Let the motor cool down.",
    "voltage": "Charge or change the battery.",
    "fall": "Set the robot up again; `g1stream report` shows what came first.",
    "target": "Check the motion with `g1stream motion`, or the program that sends the targets.",
    "loop": "End other programs, or lower stream.rate.",
    "publisher": "End the other program; `g1stream doctor` names it.",
    "guard": "End other programs, and stop neither `g1stream stream` nor its guard process.",
    "recorder": "Make room on the disk, or record elsewhere.",
}
"""What to do, by kind; a kind that is not here needs nothing."""
