"""Poses of a motion as the messages that a converted file has for each time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.foxglove.encoders import WORLD_FRAME, TfEncoder
from g1stream.foxglove.templates import JointStatesTemplate
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.rotations import quat_conj, quat_mul, quat_rotate
from g1stream.types import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from g1stream.robot.model import G1


__all__ = ["PoseEncoder", "Poses"]

_NO_TURN: Final = np.array([1.0, 0.0, 0.0, 0.0])


class Poses(NamedTuple):
    """Poses of a robot, T rows each.

    Attributes:
        stamps_ns: (T,) ns since the epoch.
        joint_pos: (T, 29) rad, motor order.
        link_pos: (T, 3) m, the root link of the motion in the world.
        link_quat_wxyz: (T, 4) likewise, unit.
        rates: joint velocities (T, 29) rad/s and accelerations (T, 29) rad/s^2, or nothing.
    """

    stamps_ns: NDArray[np.int64]
    joint_pos: Floats
    link_pos: Floats
    link_quat_wxyz: Floats
    rates: tuple[Floats, ...] = ()

    def cut(self, size: int) -> Iterator[Poses]:
        """These poses in parts of `size` rows, the last of what is left."""
        for first in range(0, len(self.stamps_ns), size):
            rows = slice(first, first + size)
            yield Poses(
                self.stamps_ns[rows],
                self.joint_pos[rows],
                self.link_pos[rows],
                self.link_quat_wxyz[rows],
                tuple(rate[rows] for rate in self.rates),
            )


class PoseEncoder:
    """Encodes poses as foxglove.FrameTransforms and foxglove.JointStates.

    Args:
        robot: whose links and joints.
        link: the link whose pose the poses say; the URDF's root link if None.
        floating: False pins that link to the world's origin.
        rates: whether the poses have velocities and accelerations.
        world: name of the world's frame.
        flat: put every link straight under the world instead of under its parent.

    Raises:
        ConfigError: a link has the name of the world's frame.
        RobotError: there is no such link.
    """

    def __init__(
        self,
        robot: G1,
        *,
        link: str | None = None,
        floating: bool = True,
        rates: bool = False,
        world: str = WORLD_FRAME,
        flat: bool = False,
    ) -> None:
        self._robot = robot
        self._link = 0 if link is None else robot.link_index(link)
        self._floating = floating
        self._tf = TfEncoder(robot, world=world, flat=flat)
        fields = ("position", "velocity", "acceleration")
        self._joints = JointStatesTemplate(robot.joint_names, fields if rates else fields[:1])

    def transforms(self, poses: Poses) -> NDArray[np.uint8]:
        """One foxglove.FrameTransforms for each time: (T, size) uint8."""
        return self._tf.encode(poses.stamps_ns, poses.joint_pos, *self._root(poses))

    def joint_states(self, poses: Poses) -> NDArray[np.uint8]:
        """One foxglove.JointStates for each time: (T, size) uint8."""
        return self._joints.encode(poses.stamps_ns, poses.joint_pos, *poses.rates)

    def _root(self, poses: Poses) -> tuple[Floats, Floats]:
        """Pose (T, 3), (T, 4) of the URDF's root link with which the poses' link is in place."""
        pos, quat = poses.link_pos, poses.link_quat_wxyz
        if not self._floating:
            pos, quat = np.zeros_like(pos), np.broadcast_to(_NO_TURN, quat.shape)
        if self._link == 0:
            return pos, quat
        in_root = forward_kinematics(self._robot, poses.joint_pos, np.zeros(3), _NO_TURN)
        root_quat = quat_mul(quat, quat_conj(in_root.quat_wxyz[:, self._link]))
        return pos - quat_rotate(root_quat, in_root.pos[:, self._link]), root_quat
