"""LAFAN1's CSV for the G1, as it is distributed. The core reads it, like any CSV."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.extras.formats.decimals import write_rows
from g1stream.extras.formats.write import Output
from g1stream.robot.rotations import xyzw_from_wxyz

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.extras.formats.write import Take

__all__ = ["LAFAN1"]


def _write(take: Take, path: Path) -> None:
    """Write 36 columns without a header: position, quaternion (xyzw), joints in motor order."""
    frames = take.frames
    table = [frames.root_pos, xyzw_from_wxyz(frames.root_quat_wxyz), frames.joint_pos]
    with path.open("wb") as file:
        write_rows(file, np.concatenate(table, axis=1), take.motion.name)


LAFAN1: Final = Output(_write, ".csv", 30)
