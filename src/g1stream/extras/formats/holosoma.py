"""The NPZ of holosoma. It is read like any NPZ."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.extras.formats.orders import names_in_order
from g1stream.extras.formats.write import Layout, Output

if TYPE_CHECKING:
    from pathlib import Path

    from g1stream.extras.formats.write import Take

__all__ = ["HOLOSOMA"]


def _write(take: Take, path: Path) -> None:
    """Write holosoma's format: `qpos` and `qvel` of MuJoCo, with the world as a body."""
    states = take.states()
    world = np.zeros((take.n_frames, 1, 3), np.float32)
    upright = np.concatenate([world[..., :1] + 1, world], axis=2)
    pelvis = states.body_pos_w[:, 0], states.body_quat_w[:, 0]
    with path.open("wb") as file:
        np.savez(
            file,
            fps=np.array([take.format.fps]),
            joint_pos=np.concatenate([*pelvis, states.joint_pos], axis=1),
            joint_vel=np.concatenate(
                [states.root_lin_vel, states.root_ang_vel, states.joint_vel], axis=1
            ),
            body_pos_w=np.concatenate([world, states.body_pos_w], axis=1),
            body_quat_w=np.concatenate([upright, states.body_quat_w], axis=1),
            body_lin_vel_w=np.concatenate([world, states.body_lin_vel_w], axis=1),
            body_ang_vel_w=np.concatenate([world, states.body_ang_vel_w], axis=1),
            joint_names=np.array(names_in_order(take.layout.order)),
            body_names=np.array(["world", *take.body_names]),
        )


# `fps` is an array of integers, as in the files of its own script.
HOLOSOMA: Final = Output(_write, ".npz", 50, Layout("motor", of_centre=True))
