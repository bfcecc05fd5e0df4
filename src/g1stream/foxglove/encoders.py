"""Transforms of a robot's links, and log lines, as Foxglove's messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, cast

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from g1stream.errors import ConfigError
from g1stream.foxglove.templates import FrameTransformsTemplate
from g1stream.robot.kinematics import forward_kinematics, local_transforms
from g1stream.robot.rotations import quat_conj, quat_mul, quat_rotate
from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from g1stream.robot.model import G1

__all__ = ["MEASURED_PREFIX", "WORLD_FRAME", "TransformsEncoder", "encode_log"]

WORLD_FRAME: Final = "world"
"""The default name of the world's frame."""

MEASURED_PREFIX: Final = "measured/"
"""Prefix of the measured robot's frame names; both robots share the world's frame."""


_IDENTITY_WXYZ: Final = np.array([1.0, 0.0, 0.0, 0.0])


class TransformsEncoder:
    """Encodes poses of a robot as foxglove.FrameTransforms, from the world down the tree of links.

    Args:
        robot: whose links.
        prefix: put before every link's name to make its frame's.
        root_link: the link whose pose is given; the URDF's root link if None.
        world: name of the world's frame, which no link may have.
        flat: put every link directly under the world instead of under its parent.

    Raises:
        ConfigError: a link's frame has the name of the world's.
        RobotError: there is no such link.
    """

    def __init__(
        self,
        robot: G1,
        prefix: str = "",
        *,
        root_link: str | None = None,
        world: str = WORLD_FRAME,
        flat: bool = False,
    ) -> None:
        frames = [f"{prefix}{name}" for name in robot.link_names]
        if world in frames:
            raise ConfigError(
                f"The world frame {world!r} has the name of a link of {robot.name}.",
                "Rename the link, or the world with --world where there is that flag.",
            )
        parents = [world if flat or parent < 0 else frames[parent] for parent in robot.parent]
        self._robot = robot
        self._link = 0 if root_link is None else robot.link_index(root_link)
        self._poses = forward_kinematics if flat else local_transforms
        self._template = FrameTransformsTemplate(parents, frames)

    def encode(
        self,
        times_ns: ArrayLike,
        joint_pos: Floats,
        root_pos: Floats,
        root_quat_wxyz: Floats,
    ) -> NDArray[np.uint8]:
        """One message per time.

        Args:
            times_ns: (T,) int64, ns since the epoch.
            joint_pos: (T, 29) rad, motor order.
            root_pos: (T, 3) m, of `root_link` in the world; or (3,) for all.
            root_quat_wxyz: (T, 4) likewise, unit, wxyz; or (4,) for all.

        Returns:
            (T, size) uint8; each row is one message.

        Raises:
            ValueError: the shapes do not fit each other, or a time is negative.
        """
        if self._link:
            in_root = forward_kinematics(self._robot, joint_pos, np.zeros(3), _IDENTITY_WXYZ)
            quat_in_root = in_root.quat_wxyz[:, self._link]
            root_quat_wxyz = quat_mul(root_quat_wxyz, quat_conj(quat_in_root))
            root_pos = root_pos - quat_rotate(root_quat_wxyz, in_root.pos[:, self._link])
        poses = self._poses(self._robot, joint_pos, root_pos, root_quat_wxyz)
        return self._template.encode(times_ns, poses.pos, poses.quat_wxyz)


def encode_log(time_ns: int, level: int, name: str, text: str) -> bytes:
    """A foxglove.Log.

    Args:
        time_ns: when it happened, ns since the epoch.
        level: 1 debug, 2 info, 3 warning, 4 error, 5 fatal.
        name: the program that logs it.
        text: what happened.
    """
    message = Log(level=cast("Log.Level.ValueType", level), name=name, message=text)
    message.timestamp.FromNanoseconds(time_ns)
    data: bytes = message.SerializeToString()
    return data
