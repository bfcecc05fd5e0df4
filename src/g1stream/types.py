"""What every room shares and no room owns: array types, log levels, phases of a session."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = [
    "ERROR",
    "INFO",
    "STREAM_RATE",
    "WARNING",
    "FeedForwardKind",
    "Floats",
    "Ints",
    "Phase",
    "Support",
]

Floats: TypeAlias = "NDArray[np.float64]"
Ints: TypeAlias = "NDArray[np.int64]"

Support = Literal["bolted", "hanging", "follow", "free"]
"""How the pelvis is held."""
FeedForwardKind = Literal["none", "velocity", "dynamics"]
"""What a command carries beside the position: nothing, velocity, or velocity and torque."""

STREAM_RATE: Final = 500.0
"""LowCmds per second unless `stream.rate` is set, Hz."""

INFO: Final = 2
"""Severity of an event, as foxglove.Log and the Log on the wire number it."""
WARNING: Final = 3
ERROR: Final = 4


class Phase(IntEnum):
    """The phase of a session, numbered as on the wire (idl/g1stream/Reference_.idl)."""

    WAIT = 0
    """for a LowState, and for a subscriber of LowCmd"""
    RAMP = 1
    """from the measured pose to the motion's first frame"""
    PLAY = 2
    HOLD = 3
    """at the motion's last frame"""
    DAMP = 4
    """no position servo, only damping"""
    DONE = 5
