"""The names that arrays of a motion have in the files of those who write them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.robot.joints import N_JOINTS

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = [
    "ANGLES",
    "BODY_POSITIONS",
    "BODY_QUATS",
    "FPS",
    "HUMAN",
    "NAMES",
    "POSITIONS",
    "QUATS",
    "READ",
    "ROOT",
    "WRITERS",
]

ANGLES: Final = (*("joint_pos", "dof_pos", "dof_positions", "dof", "qpos", "joint_angles", "q"),)
"""Joint angles, maybe with the pelvis's pose in the first `ROOT` columns."""
ROOT: Final = 7
"""Columns of a position and a quaternion."""
NAMES: Final = ("joint_names", "dof_names")
"""Of the joints."""
FPS: Final = ("fps", "framerate", "frame_rate", "mocap_framerate", "mocap_frame_rate")
"""Frames per second."""

POSITIONS: Final = ("root_pos", "root_trans", "root_trans_offset", "base_pos", "root_translation")
"""Positions of the pelvis."""
QUATS: Final = {
    "root_quat_wxyz": True,
    "root_quat_xyzw": False,
    "root_rot": False,
    "root_quat": True,
    "root_rotation": False,
    "base_quat": True,
}
"""Orientations of the pelvis, and whether w is first in them by convention."""
BODY_POSITIONS: Final = ("body_pos_w", "body_positions", "rigid_body_pos")
"""Positions of all bodies."""
BODY_QUATS: Final = {"body_quat_w": True, "body_rotations": True, "rigid_body_rot": False}
"""Orientations of all bodies, as `QUATS`."""

HUMAN: Final = {"poses", "pose_aa", "betas"}
"""Arrays of the motions of human body models."""

WRITERS: Final = (
    ("holosoma", {"joint_pos", "joint_names", "body_pos_w"}),
    ("BeyondMimic and mjlab", {"joint_pos", "body_pos_w"}),
    ("GMR", {"root_pos", "root_rot", "dof_pos"}),
    ("PHC and ASAP", {"root_trans_offset", "dof"}),
    ("ProtoMotions", {"dof_pos", "rigid_body_pos", "rigid_body_rot"}),
    ("AMP for Isaac Lab", {"dof_positions", "body_positions"}),
    ("MuJoCo", {"qpos"}),
)
"""Who writes files with these arrays; the first that fits."""


def _any_of(names: Iterable[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} or {last}"


READ: Final = (
    f"Read are joint angles as {_any_of(ANGLES)}, (T, {N_JOINTS}), or (T, {ROOT + N_JOINTS}) with "
    f"the pelvis's position and quaternion before them; the pelvis as {_any_of(POSITIONS)} with "
    f"{_any_of(QUATS)}, or as the first body of {_any_of(BODY_POSITIONS)} with "
    f"{_any_of(BODY_QUATS)}; {_any_of(FPS)}; {_any_of(NAMES)}."
)
"""What is read, for whoever has a file with other arrays."""
