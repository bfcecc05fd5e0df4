"""How a motion was changed so that a robot on its feet can play it, as a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.soles import OFF_FLOOR, SIDES, Soles
from g1stream.robot.standing import LEGS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from g1stream.physics.stance import Standing
    from g1stream.types import Floats

__all__ = ["draw_standing"]

_COLOURS: Final = ("#0072b2", "#d55e00")
_PELVIS: Final = "#1a1a1a"
#: Joints of the legs that are drawn: those that were changed most.
_JOINTS: Final = 4


def draw_standing(standing: Standing) -> Figure:
    """See `Standing.plot`."""
    from matplotlib.figure import Figure

    soles = Soles(standing.robot)
    before, after = standing.before, standing.motion
    paths = [
        soles.path(one.joint_pos, one.root_pos, one.root_quat_wxyz).reshape(-1, 2, 4, 3)
        for one in (before, after)
    ]
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    figure.suptitle(f"{after.name}: as it was (thin), and as it is played on the feet")
    axes = figure.subplot_mosaic(
        [["top", "soles"], ["top", "height"], ["top", "joints"]], width_ratios=[1.0, 1.3]
    )
    _draw_from_above(axes["top"], standing, paths[1])
    times = np.arange(after.n_frames) / after.fps
    for axis in (axes["soles"], axes["height"], axes["joints"]):
        axis.set_xlim(0.0, times[-1])
        axis.grid(alpha=0.3)
    for path, width in zip(paths, (0.8, 1.8), strict=True):
        lowest = 1e3 * path[..., 2].min(axis=2)
        for foot, side in enumerate(SIDES):
            label = f"{side} foot" if width > 1.0 else None
            axes["soles"].plot(times, lowest[:, foot], _COLOURS[foot], lw=width, label=label)
    axes["soles"].set(title="lowest point of each sole above the floor", ylabel="mm")
    axes["soles"].legend(fontsize="small")
    for one, width in ((before, 0.8), (after, 1.8)):
        axes["height"].plot(times, 1e3 * one.root_pos[:, 2], _PELVIS, lw=width)
    axes["height"].set(title="height of the pelvis", ylabel="mm")
    change = np.degrees(after.joint_pos - before.joint_pos)[:, :LEGS]
    for joint in np.argsort(-np.abs(change).max(axis=0))[:_JOINTS]:
        name = JOINT_NAMES[joint].removesuffix("_joint")
        axes["joints"].plot(times, change[:, joint], lw=1.2, label=name)
    axes["joints"].set(title="joints that were changed most", xlabel="time, s", ylabel="change, °")
    axes["joints"].legend(fontsize="small")
    return figure


def _draw_from_above(axis: Axes, standing: Standing, corners: Floats) -> None:
    """The soles where they stand, and the ways of the pelvis, m."""
    for foot, side in enumerate(SIDES):
        stands = corners[:, foot, :, 2].min(axis=1) < OFF_FLOOR
        places = np.unique(corners[stands, foot, :, :2].round(3), axis=0)
        for k, place in enumerate(places):
            label = f"{side} sole" if k == 0 else None
            axis.fill(*place.T, facecolor="none", edgecolor=_COLOURS[foot], lw=1.2, label=label)
    for one, width, label in ((standing.before, 0.8, None), (standing.motion, 1.8, "pelvis")):
        axis.plot(*one.root_pos[:, :2].T, _PELVIS, lw=width, label=label)
    axis.set(title="from above", xlabel="x, m", ylabel="y, m", aspect="equal")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")
