"""The pickle of GMR. It is read like any pickle."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.extras.formats.write import Output
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.kinematics import BLOCK, forward_kinematics
from g1stream.robot.rotations import quat_rotate, xyzw_from_wxyz

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.extras.formats.write import Take

__all__ = ["GMR"]

_LINKS: Final = [
    name.replace("waist_pitch", "torso").removesuffix("_joint") + "_link" for name in JOINT_NAMES
]
#: The bodies of GMR's robot, `g1_mocap_29dof.xml`, in the order in which GMR lists them: depth
#: first. TWIST takes the list of the first file for all files, so that each needs the same.
_BODIES: Final = (
    *("pelvis", *_LINKS[:6], "left_toe_link", "pelvis_contour_link"),
    *(*_LINKS[6:12], "right_toe_link"),
    *(*_LINKS[12:15], "head_link", "head_mocap", "imu_in_torso"),
    *(*_LINKS[15:22], "left_rubber_hand", *_LINKS[22:], "right_rubber_hand"),
)
#: Its bodies without a joint: the body that each is fixed to, and its origin there, m.
_FIXED: Final = {
    "left_toe_link": ("left_ankle_roll_link", (0.1, 0.0, -0.02)),
    "right_toe_link": ("right_ankle_roll_link", (0.1, 0.0, -0.02)),
    "pelvis_contour_link": ("pelvis", (0.0, 0.0, 0.0)),
    "head_link": ("torso_link", (0.0039635, 0.0, -0.044)),
    "head_mocap": ("torso_link", (0.0, 0.0, 0.4)),
    "imu_in_torso": ("torso_link", (-0.03959, -0.00224, 0.14792)),
    "left_rubber_hand": ("left_wrist_yaw_link", (0.0415, 0.003, 0.0)),
    "right_rubber_hand": ("right_wrist_yaw_link", (0.0415, -0.003, 0.0)),
}


def _write(take: Take, path: Path) -> None:
    """Write GMR's pickled dict with joint names; `local_body_pos` is in the pelvis's frame."""
    motion, robot = take.motion, take.robot
    local = np.empty((motion.n_frames, len(_BODIES), 3), np.float32)
    links = [0, *(robot.joint_of_link.tolist().index(joint) for joint in range(N_JOINTS))]
    link_of = dict(zip(("pelvis", *_LINKS), links, strict=True))
    for first in range(0, motion.n_frames, BLOCK):
        part = slice(first, first + BLOCK)
        pose = forward_kinematics(
            robot, motion.joint_pos[part], np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        )
        for body, name in enumerate(_BODIES):
            parent, origin = _FIXED.get(name, (name, (0.0, 0.0, 0.0)))
            offset = quat_rotate(pose.quat_wxyz[:, link_of[parent]], np.array(origin))
            local[part, body] = pose.pos[:, link_of[parent]] + offset
        take.on_progress(min(1.0, part.stop / motion.n_frames))
    content = {
        "fps": motion.fps,
        "root_pos": motion.root_pos,
        "root_rot": xyzw_from_wxyz(motion.root_quat_wxyz),
        "dof_pos": motion.joint_pos,
        "local_body_pos": local,
        "link_body_list": list(_BODIES),
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
