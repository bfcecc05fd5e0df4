"""What is derived from samples to be looked at: transforms, joint states, log lines."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, cast

from foxglove_schemas_protobuf.Log_pb2 import Log

from g1stream.errors import ConfigError
from g1stream.foxglove.templates import FrameTransformsTemplate, JointStatesTemplate
from g1stream.robot.kinematics import forward_kinematics, local_transforms

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from g1stream.robot.model import G1

__all__ = ["MEASURED_PREFIX", "WORLD_FRAME", "JointStatesEncoder", "TfEncoder", "encode_log"]

WORLD_FRAME: Final = "world"
"""The frame that the root link is posed in, unless told otherwise."""

MEASURED_PREFIX: Final = "measured/"
"""Sets the measured robot's frames apart from the reference's; the world they share."""


class TfEncoder:
    """Encodes poses of a robot as foxglove.FrameTransforms, from the world down the tree of links.

    Args:
        robot: whose links.
        prefix: put before every link's name to make its frame's.
        world: name of the world's frame, which no link may have.
        flat: put every link straight under the world instead of under its parent.

    Raises:
        ConfigError: a link's frame has the name of the world's.
    """

    def __init__(
        self, robot: G1, prefix: str = "", *, world: str = WORLD_FRAME, flat: bool = False
    ) -> None:
        frames = [f"{prefix}{name}" for name in robot.link_names]
        if world in frames:
            raise ConfigError(
                f"The world's frame cannot be called {world!r}: a link of {robot.name} is.",
                "Rename the link, or the world with --world where there is that flag.",
            )
        parents = [world if flat or parent < 0 else frames[parent] for parent in robot.parent]
        self._robot = robot
        self._poses = forward_kinematics if flat else local_transforms
        self._template = FrameTransformsTemplate(parents, frames)

    def encode(
        self,
        stamps_ns: ArrayLike,
        joint_pos: NDArray[np.float64],
        root_pos: NDArray[np.float64],
        root_quat_wxyz: NDArray[np.float64],
    ) -> NDArray[np.uint8]:
        """One message per stamp.

        Args:
            stamps_ns: (T,) int64, ns since the epoch.
            joint_pos: (T, 29) rad, motor order.
            root_pos: (T, 3) m, world; or (3,) for all.
            root_quat_wxyz: (T, 4) root to world, unit, wxyz; or (4,) for all.

        Returns:
            (T, size) uint8; each row is one message.

        Raises:
            ValueError: the shapes do not fit each other, or a stamp is negative.
        """
        poses = self._poses(self._robot, joint_pos, root_pos, root_quat_wxyz)
        return self._template.encode(stamps_ns, poses.pos, poses.quat_wxyz)


class JointStatesEncoder:
    """Encodes the joints of a robot as foxglove.JointStates, in motor order.

    Args:
        robot: whose joints.
    """

    def __init__(self, robot: G1) -> None:
        fields = ("position", "velocity", "acceleration", "effort")
        self._template = JointStatesTemplate(robot.joint_names, fields)

    def encode(
        self, stamps_ns: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, tau: ArrayLike
    ) -> NDArray[np.uint8]:
        """One message per stamp.

        Args:
            stamps_ns: (T,) int64, ns since the epoch.
            q: (T, 29) rad, motor order.
            dq: (T, 29) rad/s.
            ddq: (T, 29) rad/s^2.
            tau: (T, 29) Nm.

        Returns:
            (T, size) uint8; each row is one message.

        Raises:
            ValueError: the shapes do not fit each other, or a stamp is negative.
        """
        return self._template.encode(stamps_ns, q, dq, ddq, tau)


def encode_log(stamp_ns: int, level: int, name: str, text: str) -> bytes:
    """A foxglove.Log.

    Args:
        stamp_ns: when it happened, ns since the epoch.
        level: 1 debug, 2 info, 3 warning, 4 error, 5 fatal.
        name: the program that tells it.
        text: what happened.
    """
    message = Log(level=cast("Log.Level.ValueType", level), name=name, message=text)
    message.timestamp.FromNanoseconds(stamp_ns)
    data: bytes = message.SerializeToString()
    return data
