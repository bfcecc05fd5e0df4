"""Shared types: arrays, phases of a session, values of settings, and the default stream rate."""

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
    "Profile",
    "StopKind",
    "StreamSupport",
    "Support",
    "Velocities",
    "Via",
]

Floats: TypeAlias = "NDArray[np.float64]"
Ints: TypeAlias = "NDArray[np.int64]"

Support = Literal["bolted", "hanging", "follow", "free"]
"""Support of the pelvis."""
StreamSupport = Literal["bolted", "hanging", "follow", "free", "feet"]
"""Support of the pelvis that a stream assumes; with `feet`, nothing holds the robot and the stream
balances it."""
FeedForwardKind = Literal["none", "velocity", "dynamics"]
"""Feed-forward of a command beside its position: nothing, velocity, or velocity and torque."""
BeyondLimits = Literal["refuse", "scale-time", "clamp", "anyway"]
"""Handling of a motion beyond the robot's limits."""

JointOrder = Literal["motor", "isaaclab", "motor-23dof"]
"""Order of joints: `motor` as in LowCmd, the URDF and MuJoCo; `isaaclab` breadth first, as in Isaac
Sim; `motor-23dof` is motor order of the joints that the G1 with 23 has."""

MotionFormat = Literal["beyondmimic", "mjlab", "holosoma", "sonic", "lafan1", "gmr"]
"""A format of motion files for other programs; docs/formats.md lists the programs."""

Velocities = Literal["spline", "finite"]
"""Velocities in a motion file: derivatives of the spline through the frames, as they are streamed,
or finite differences between the frames of the file."""

OnboardMode = Literal["ai", "normal", "advanced"]
"""One of the robot's own controllers, by its name in the motion service."""

OtherJoints = Literal["hold", "free"]
"""Behaviour of joints that do not play the motion: keep the measured pose, or only damp."""

Profile = Literal["simulator", "network-simulator", "robot"]
"""Whom settings that are not given are for; `network-simulator` has the values of `simulator`, and
says that no robot can be reached on the network."""

Via = Literal["lowcmd", "arm_sdk"]
"""Receiver of commands: the motors, or the robot's own controller, which moves arms and waist."""

ChannelSet = Literal["raw", "standard", "full"]
"""Channels of a session file beside the samples, the log and the metadata. `raw` has none,
`standard` has those for viewers, at `record.tf_rate`, and `full` also has the joint states of every
sample."""

StopKind = Literal[
    "signal",
    "requested",
    "operator",
    "no_robot",
    "state",
    "robot",
    "tilt",
    "speed",
    "torque",
    "tracking",
    "jam",
    "motor",
    "temperature",
    "voltage",
    "fall",
    "target",
    "loop",
    "publisher",
    "guard",
    "recorder",
    "error",
]
"""Why a session ends early: a signal, a program (`requested`), the remote (`operator`), no robot
within `stream.wait`, a LowState that is missing or implausible (`state`), another robot than the
configured one, its condition (tilt to voltage), a source that cannot keep it on its feet (`fall`),
a target that a joint cannot follow, a loop that misses its ticks, another publisher, the guard
process, a required recording, or an exception."""

Camera = Literal["front", "oblique", "left", "back", "right"]
"""Position of a video's camera around the robot."""

MAX_GAP_NS: Final = 100_000_000
"""Gap between samples, ns, above which nothing is known about the time between them."""

STREAM_RATE: Final = 500.0
"""LowCmds per second unless `stream.rate` is set, Hz."""


class Phase(IntEnum):
    """The phase of a session, numbered as on DDS (idl/g1stream/Reference_.idl)."""

    WAIT = 0
    """Wait for a LowState and for a subscriber of LowCmd."""
    RAMP = 1
    """Move from the measured pose to the motion's first frame."""
    PLAY = 2
    HOLD = 3
    """Stay at the motion's last frame."""
    DAMP = 4
    """Damp without a position servo."""
    DONE = 5
