"""The NPZ of BeyondMimic (whole_body_tracking), and that of mjlab: the same arrays in other orders.

They are read like any NPZ.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.extras.formats.orders import names_in_order
from g1stream.extras.formats.write import Layout, Output

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.extras.formats.write import Take

__all__ = ["BEYONDMIMIC", "MJLAB"]


def _write(take: Take, path: Path) -> None:
    """Write the format of the motion loaders of both.

    The names are an addition: their own files have none, and the loaders ignore them.
    """
    states = take.states()
    with path.open("wb") as file:
        np.savez(
            file,
            fps=np.array([take.format.fps]),
            joint_pos=states.joint_pos,
            joint_vel=states.joint_vel,
            body_pos_w=states.body_pos_w,
            body_quat_w=states.body_quat_w,
            body_lin_vel_w=states.body_lin_vel_w,
            body_ang_vel_w=states.body_ang_vel_w,
            joint_names=np.array(names_in_order(take.layout.order)),
            body_names=np.array(take.body_names),
        )


# `fps` is an array of integers or floats, as in the files of the format's own script.
BEYONDMIMIC: Final = Output(_write, ".npz", 50, Layout("isaaclab", of_centre=True))
MJLAB: Final = Output(_write, ".npz", 50.0, Layout("motor", of_centre=False))
