"""What a robot with fewer joints leaves out of a motion, and by how much that moves hands and head.

Joints are dropped by name: the robot's own play as in the motion, the others stay at 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import forward_kinematics
from g1stream.robot.model import G1

if TYPE_CHECKING:
    from g1stream.motion.motion import Motion

__all__ = ["Dropped", "dropped_joints"]

#: Of the G1 with all joints: what it touches and looks with. The lidar is in the head.
_LINKS: Final = {
    "left hand": "left_rubber_hand",
    "right hand": "right_rubber_hand",
    "head": "mid360_link",
}
#: Frames that are looked at are no more than this.
_MOST_FRAMES: Final = 2000


@dataclass(frozen=True)
class Dropped:
    """Joints of a motion that a robot does not have.

    Attributes:
        robot: its name.
        joints: their names.
        moved: those of them that are not 0 throughout the motion, and are missed.
        errors_mm: of each hand and the head the mean and the greatest distance, mm, from where the
            motion has it in the pelvis's frame.
    """

    robot: str
    joints: tuple[str, ...]
    moved: tuple[str, ...]
    errors_mm: dict[str, tuple[float, float]]

    def __str__(self) -> str:
        lacks = f"{self.robot} lacks {_short(self.joints)}, which stay at 0"
        if not self.moved:
            return f"{lacks}, as in the motion"
        errors = ", ".join(
            f"{part} {mean:.0f} mm on average, {most:.0f} at most"
            for part, (mean, most) in self.errors_mm.items()
        )
        which = "all" if self.moved == self.joints else _short(self.moved)
        return f"{lacks}; the motion moves {which} of them: {errors} from the motion's"


def _short(joints: tuple[str, ...]) -> str:
    return ", ".join(name.removesuffix("_joint") for name in joints)


def dropped_joints(motion: Motion, robot: G1) -> Dropped | None:
    """What the robot leaves out of a motion; None where it has all joints."""
    absent = ~robot.present
    if not absent.any():
        return None
    q = motion.joint_pos[:: max(1, -(-motion.n_frames // _MOST_FRAMES))]
    moved = absent & (motion.joint_pos != 0.0).any(axis=0)
    full, base = G1.default(), (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    links = [full.link_index(link) for link in _LINKS.values()]
    asked, done = (
        forward_kinematics(full, one, *base).pos[:, links] for one in (q, q * robot.present)
    )
    distance = np.linalg.norm(asked - done, axis=-1) * 1e3
    errors = zip(_LINKS, distance.mean(axis=0).tolist(), distance.max(axis=0).tolist(), strict=True)
    return Dropped(
        robot.joint_set.name,
        tuple(JOINT_NAMES[i] for i in np.flatnonzero(absent)),
        tuple(JOINT_NAMES[i] for i in np.flatnonzero(moved)),
        {part: (mean, most) for part, mean, most in errors},
    )
