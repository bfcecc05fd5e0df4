"""The pickle of GMR. It is read like any pickle."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.extras.formats.write import Output
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.kinematics import BLOCK, forward_kinematics
from g1stream.robot.rotations import quat_rotate, xyzw_from_wxyz

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.extras.formats.write import Take

__all__ = ["GMR"]

#: Links of GMR's robot that a URDF lacks: the link that each is fixed to, and its origin there, m.
#: The values are from `g1_mocap_29dof.xml` of GMR.
_OF_GMR: Final = {
    "left_toe_link": ("left_ankle_roll_link", (0.1, 0.0, -0.02)),
    "right_toe_link": ("right_ankle_roll_link", (0.1, 0.0, -0.02)),
    "head_mocap": ("torso_link", (0.0, 0.0, 0.4)),
}


def _write(take: Take, path: Path) -> None:
    """Write GMR's pickled dict with joint names; `local_body_pos` is in the pelvis's frame."""
    motion, robot = take.motion, take.robot
    names = dict.fromkeys((*robot.link_names, *_OF_GMR))
    local = np.empty((motion.n_frames, len(names), 3), np.float32)
    for first in range(0, motion.n_frames, BLOCK):
        part = slice(first, first + BLOCK)
        pose = forward_kinematics(
            robot, motion.joint_pos[part], np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        )
        local[part, : len(robot.link_names)] = pose.pos
        for body, name in enumerate(names):
            if name not in robot.link_names:
                parent, origin = _OF_GMR[name]
                link = robot.link_index(parent)
                offset = quat_rotate(pose.quat_wxyz[:, link], np.array(origin))
                local[part, body] = pose.pos[:, link] + offset
        take.on_progress(min(1.0, part.stop / motion.n_frames))
    content = {
        "fps": motion.fps,
        "root_pos": motion.root_pos,
        "root_rot": xyzw_from_wxyz(motion.root_quat_wxyz),
        "dof_pos": motion.joint_pos,
        "local_body_pos": local,
        "link_body_list": list(names),
        "joint_names": list(JOINT_NAMES),
    }
    with path.open("wb") as file:
        _Pickler(file, protocol=4).dump(content)


class _Pickler(pickle.Pickler):
    """Pickles arrays so that every numpy version reads them.

    numpy 2 itself would name a module that numpy 1 lacks.
    """

    def reducer_override(self, value: Any) -> Any:
        if type(value) is not np.ndarray:
            return NotImplemented
        return np.ndarray, ((0,), "b"), np.ascontiguousarray(value).__reduce__()[2]


GMR: Final = Output(_write, ".pkl")
