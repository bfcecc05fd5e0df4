"""The links and joints of a robot, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from g1stream.errors import RobotError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["KinematicTree"]


@dataclass(frozen=True, eq=False)
class KinematicTree:
    """What a URDF says about frames and limits. All arrays are read-only.

    L counts the links, moving and fixed ones. A link's joint is the one between it and its parent;
    its frame sits at the joint's origin, turned by `joint_pos` about the joint's axis.

    Attributes:
        name: the URDF's robot name.
        link_names: (L,) root first, parents before children.
        parent: (L,) index of the parent link, -1 for the root.
        joint_of_link: (L,) index into `joint_names` of the link's joint, -1 where it does not move.
        origin_pos: (L, 3) m, the joint's origin in the parent link's frame.
        origin_quat_wxyz: (L, 4) likewise, at zero joint position.
        axis: (L, 3) unit axis in the link's own frame, zero where the link does not move.
        joint_names: (29,) motor order.
        lower: (29,) rad.
        upper: (29,) rad.
        velocity: (29,) rad/s, greatest speed either way.
        effort: (29,) N·m, greatest torque either way.
        ignored_joints: moving joints that are not the G1's own (fingers); they are held at zero.
    """

    name: str
    link_names: tuple[str, ...]
    parent: NDArray[np.intp]
    joint_of_link: NDArray[np.intp]
    origin_pos: NDArray[np.float64]
    origin_quat_wxyz: NDArray[np.float64]
    axis: NDArray[np.float64]
    joint_names: tuple[str, ...]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    velocity: NDArray[np.float64]
    effort: NDArray[np.float64]
    ignored_joints: tuple[str, ...]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def link_index(self, name: str) -> int:
        """Index of a link.

        Raises:
            RobotError: there is no link of this name.
        """
        if name not in self.link_names:
            raise RobotError(
                f"The robot {self.name!r} has no link {name!r}.",
                f"Its links are {', '.join(self.link_names)}.",
            )
        return self.link_names.index(name)

    @cached_property
    def levels(self) -> tuple[NDArray[np.intp], ...]:
        """Link indices grouped by their distance from the root, nearest first, without the root.

        Links of one level depend on the level before only, so kinematics takes a level at a time.
        """
        depth = np.zeros(len(self.parent), dtype=np.intp)
        for link, parent in enumerate(self.parent[1:], start=1):
            depth[link] = depth[parent] + 1
        return tuple(np.flatnonzero(depth == level) for level in range(1, int(depth.max()) + 1))
