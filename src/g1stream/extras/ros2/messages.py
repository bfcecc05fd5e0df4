"""ROS 2 messages in CDR, encoded with rosbags. Times in arguments are ns since the epoch."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros2_humble as ros

from g1stream.extras.attach.recorded_motion import FramePose

STORE: Final = get_typestore(Stores.ROS2_HUMBLE)
"""The definitions of ROS 2 messages. Those used here are equal in every ROS 2 since Foxy."""


def encode(message: Any) -> bytes:
    """Encode a message in CDR."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=True))


def time_message(time_ns: int) -> Any:
    """A builtin_interfaces/Time."""
    return ros.builtin_interfaces__msg__Time(*divmod(time_ns, 1_000_000_000))


def joint_state(time_ns: int, names: Iterable[str], *columns: ArrayLike) -> bytes:
    """A sensor_msgs/JointState: positions, rad, velocities, rad/s, efforts, N·m, (J) or empty."""
    header = ros.std_msgs__msg__Header(time_message(time_ns), "")
    arrays = (np.asarray(column, np.float64) for column in columns)
    return encode(ros.sensor_msgs__msg__JointState(header, list(names), *arrays))


def tf_message(transforms: Iterable[FramePose]) -> bytes:
    """A tf2_msgs/TFMessage."""
    messages = []
    for time_ns, parent, child, pos, (w, x, y, z) in transforms:
        pose = ros.geometry_msgs__msg__Transform(
            ros.geometry_msgs__msg__Vector3(*pos), ros.geometry_msgs__msg__Quaternion(x, y, z, w)
        )
        header = ros.std_msgs__msg__Header(time_message(time_ns), parent)
        messages.append(ros.geometry_msgs__msg__TransformStamped(header, child, pose))
    return encode(ros.tf2_msgs__msg__TFMessage(messages))
