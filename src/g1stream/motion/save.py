"""Writes a motion as a file that is read back to the last bit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.files import check_not_input, complete_file
from g1stream.motion.csv import to_csv

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.motion.motion import Motion

__all__ = ["MOTION_SUFFIXES", "save_motion"]

MOTION_SUFFIXES: Final = (".csv", ".npz")
"""Of the files that are written."""


def save_motion(motion: Motion, path: Path, *, force: bool = False) -> None:
    """See `Motion.save`."""
    suffix = path.suffix.lower()
    if suffix not in MOTION_SUFFIXES:
        raise MotionError(
            f"A motion cannot be saved as {path.name}.",
            f"Give a file name that ends in {', '.join(MOTION_SUFFIXES)}.",
        )
    check_not_input(path, motion.source)
    with complete_file(path, force=force) as temporary:
        if suffix == ".csv":
            temporary.write_text(to_csv(motion), encoding="utf-8")
        else:
            with temporary.open("wb") as file:
                np.savez_compressed(
                    file,
                    fps=motion.fps,
                    joint_names=np.array(motion.joint_names),
                    joint_pos=motion.joint_pos,
                    root_pos=motion.root_pos,
                    root_quat_wxyz=motion.root_quat_wxyz,
                )
