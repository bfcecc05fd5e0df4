"""Types that all rooms share: arrays, phases of a session, the values of settings, stream rate."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = [
    "MAX_GAP_NS",
    "STREAM_RATE",
    "BeyondLimits",
    "Camera",
    "ChannelSet",
    "FeedForwardKind",
    "Floats",
    "Ints",
    "JointOrder",
    "MotionFormat",
    "OnboardMode",
    "OtherJoints",
    "Phase",
    "StreamSupport",
    "Support",
    "Velocities",
    "Via",
]

Floats: TypeAlias = "NDArray[np.float64]"
Ints: TypeAlias = "NDArray[np.int64]"

Support = Literal["bolted", "hanging", "follow", "free"]
"""How the pelvis is held."""
StreamSupport = Literal["bolted", "hanging", "follow", "free", "feet"]
"""What a stream takes for granted: how the pelvis is held, or with `feet` that nothing holds it and
the stream keeps the robot on its feet."""
FeedForwardKind = Literal["none", "velocity", "dynamics"]
"""What a command carries beside the position: nothing, velocity, or velocity and torque."""
BeyondLimits = Literal["refuse", "scale-time", "clamp", "anyway"]
"""What to do about a motion beyond the robot's limits."""

JointOrder = Literal["motor", "isaaclab"]
"""`motor`: that of LowCmd, the URDF and MuJoCo; `isaaclab`: breadth first, as Isaac Sim numbers the
joints of a tree."""

MotionFormat = Literal["beyondmimic", "mjlab", "holosoma", "sonic", "lafan1", "gmr"]
"""A format of motion files that other programs read; docs/formats.md says which."""

Velocities = Literal["spline", "finite"]
"""What the velocities in a motion file are: derivatives of the spline through the frames, as they
are streamed, or differences between the frames of the file."""

OnboardMode = Literal["ai", "normal", "advanced"]
"""A controller of the robot's own, by its name in the motion service."""

OtherJoints = Literal["hold", "free"]
"""What joints that do not play the motion do: keep their measured pose, or only damp."""

Via = Literal["lowcmd", "arm_sdk"]
"""Whom commands go to: the motors, or the robot's own controller, which moves arms and waist."""

ChannelSet = Literal["raw", "standard", "full"]
"""What a session file has beside the samples, the log and the metadata: nothing; what viewers show,
at `record.tf_rate`; the same with the joint states of every sample."""

Camera = Literal["front", "oblique", "left", "back", "right"]
"""Where the camera of a video stands around the robot."""

MAX_GAP_NS: Final = 100_000_000
"""Samples further apart than this, ns, say nothing of the time between them."""

STREAM_RATE: Final = 500.0
"""LowCmds per second unless `stream.rate` is set, Hz."""


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
