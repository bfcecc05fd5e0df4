"""How a motion was changed so that a robot on its feet can play it, as a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.joints import JOINT_NAMES, LEGS
from g1stream.robot.soles import OFF_FLOOR, SIDES, Soles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from g1stream.extras.physics.stance import Standing
    from g1stream.types import Floats

__all__ = ["draw_standing"]

_COLOURS: Final = ("#0072b2", "#d55e00")
_PELVIS: Final = "#1a1a1a"
_THIN, _THICK = 0.8, 1.8
#: Joints of the legs that are drawn: those that were changed most.
_JOINTS: Final = 4
#: The least height of a diagram, mm, so that noise looks like none; of that of joints, degrees.
_LEAST: Final = 20.0
_LEAST_CHANGE: Final = 1.0


def draw_standing(standing: Standing) -> Figure:
    """See `Standing.plot`."""
    from matplotlib.figure import Figure

    soles = Soles(standing.robot)
    before, after, frames = standing.before, standing.motion, standing.frames
    paths = [
        soles.path(one.joint_pos, one.root_pos, one.root_quat_wxyz).reshape(-1, 2, 4, 3)
        for one in (before, after)
    ]
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    legs = ", on legs that stand" * standing.upper_body
    figure.suptitle(f"{after.name}{legs}: as it was (thin), and as it is played on the feet")
    axes = figure.subplot_mosaic(
        [["top", "soles"], ["top", "height"], ["top", "joints"]], width_ratios=[1.0, 1.3]
    )
    played = slice(frames.start, frames.stop)
    _draw_from_above(axes["top"], standing, *(path[played] for path in paths))
    times = np.arange(after.n_frames) / after.fps
    for one, path, width in ((before, paths[0], _THIN), (after, paths[1], _THICK)):
        lowest = 1e3 * path[..., 2].min(axis=2)
        for foot, side in enumerate(SIDES):
            label = f"{side} foot" if width == _THICK else None
            axes["soles"].plot(times, lowest[:, foot], _COLOURS[foot], lw=width, label=label)
        axes["height"].plot(times, 1e3 * one.root_pos[:, 2], _PELVIS, lw=width)
    axes["soles"].set(title="lowest point of each sole above the floor", ylabel="mm")
    axes["height"].set(title="height of the pelvis", ylabel="mm")
    change = np.degrees(after.joint_pos - before.joint_pos)[:, :LEGS]
    for joint in np.argsort(-np.abs(change).max(axis=0))[:_JOINTS]:
        name = JOINT_NAMES[joint].removesuffix("_joint")
        style = "--" if name.startswith("right") else "-"  # both legs often do the same
        axes["joints"].plot(times, change[:, joint], style, lw=1.2, label=name)
    axes["joints"].set(
        title="joints of the legs that were changed most", xlabel="time, s", ylabel="change, °"
    )
    for name, least in (("soles", _LEAST), ("height", _LEAST), ("joints", _LEAST_CHANGE)):
        low, high = axes[name].get_ylim()
        more = max(0.0, least - (high - low)) / 2.0
        axes[name].set(xlim=times[[frames[0], frames[-1]]], ylim=(low - more, high + more))
        axes[name].grid(alpha=0.3)
    for name in ("soles", "joints"):
        axes[name].legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _draw_from_above(axis: Axes, standing: Standing, before: Floats, after: Floats) -> None:
    """The soles where they stand, (T, 2, 4, 3), and the ways of the pelvis, m."""
    for foot, side in enumerate(SIDES):
        stands = np.flatnonzero(after[:, foot, :, 2].min(axis=1) < OFF_FLOOR)
        places = after[stands, foot, :, :2].round(3)
        for k, place in enumerate(np.unique(places, axis=0)):
            there = stands[(places == place).all(axis=(1, 2))]
            was = before[there[len(there) // 2], foot, :, :2]
            for corners, width in ((was, _THIN), (place, _THICK)):
                label = f"{side} sole" if k == 0 and width == _THICK else None
                edge = _COLOURS[foot]
                axis.fill(*corners.T, facecolor="none", edgecolor=edge, lw=width, label=label)
    for one, width, label in (
        (standing.before, _THIN, None),
        (standing.motion, _THICK, "pelvis"),
    ):
        axis.plot(*one.root_pos[:, :2].T, _PELVIS, lw=width, label=label)
    axis.set(title="from above", xlabel="x, m", ylabel="y, m", aspect="equal")
    axis.locator_params(nbins=6)
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
