"""The joint angles of a session, read without all else that its samples carry.

They are a quarter of the samples, and of the memory that those of a long session take.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from g1stream.session.streams import Measured, Reference, Stream
from g1stream.types import Floats

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


__all__ = ["AskedAngles", "MeasuredAngles"]


@dataclass(frozen=True, eq=False)
class AskedAngles(Stream):
    """What the motion asked for: of `Reference`, the attributes of the same name.

    Attributes:
        motion_time: (N,) s since the motion's first frame.
        phase: (N,) 0 WAIT, 1 RAMP, 2 PLAY, 3 HOLD, 4 DAMP, 5 DONE.
        q: (N, 29) rad, motor order.
    """

    topic = Reference.topic
    source = Reference.source

    motion_time: Floats
    phase: NDArray[np.uint8]
    q: Floats


@dataclass(frozen=True, eq=False)
class MeasuredAngles(Stream):
    """What the robot reported: of `Measured`, the attribute of the same name.

    Attributes:
        q: (N, 29) rad, motor order.
    """

    topic = Measured.topic
    source = Measured.source
    paths: ClassVar = {"q": Measured.paths["q"]}

    q: Floats
