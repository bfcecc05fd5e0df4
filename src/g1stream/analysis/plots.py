"""One picture of a session: what was asked of the joints, and what they did."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.analysis.metrics import by_group, pooled
from g1stream.analysis.plot_data import binned_rms, joints_to_show, make_scene
from g1stream.errors import RecordingError
from g1stream.files import complete_file
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from g1stream.analysis.metrics import Tracking
    from g1stream.analysis.plot_data import Scene
    from g1stream.session.session import Session

__all__ = ["draw"]

_INCHES: Final = (16.0, 10.0)
_DPI: Final = 100

_DARK, _MUTED, _PALE = "#1a1a1a", "#5f6670", "#d5d9de"
_COLOURS: Final = dict(
    zip(JOINT_GROUPS, ("#0072b2", "#56b4e9", "#009e73", "#d55e00", "#cc79a7"), strict=True)
)
_GROUP_OF: Final = {joint: group for group, joints in JOINT_GROUPS.items() for joint in joints}
_SHADES: Final = {Phase.RAMP: "#eef1f5", Phase.HOLD: "#eef1f5", Phase.DAMP: "#f8e9e7"}

#: A phase that takes less of the width than this is not named in the picture.
_NARROW: Final = 0.04

_MEASURED: Final[Mapping[str, Any]] = {"label": "measured", "linewidth": 2.0}
_REFERENCE: Final[Mapping[str, Any]] = {
    "label": "reference",
    "linewidth": 1.1,
    "linestyle": (0, (4, 2)),
    "color": _DARK,
}
_STYLE: Final[Mapping[str, Any]] = {
    "font.size": 9,
    "axes.edgecolor": _PALE,
    "axes.labelcolor": _MUTED,
    "axes.titlecolor": _DARK,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9ecef",
    "grid.linewidth": 0.7,
    "xtick.color": _MUTED,
    "ytick.color": _MUTED,
    "legend.frameon": False,
}


def draw(session: Session, path: str | Path) -> None:
    """Write the figure of a session to a PNG.

    The file appears when it is whole; one that is there already is replaced.

    Raises:
        RecordingError: the session lacks references or states, or the picture cannot be written.
    """
    from matplotlib import style

    with style.context(["default", dict(_STYLE)]):
        _save(plot(session), Path(path))


def plot(session: Session, joints: Sequence[str] | None = None) -> Figure:
    """The joints that move most, the error over time and each joint's RMSE.

    Args:
        session: with reference and state.
        joints: names of up to six joints to show instead of those that move most.

    Raises:
        RecordingError: the session lacks references or states, or there is no such joint.
    """
    from matplotlib import style
    from matplotlib.figure import Figure

    scene = make_scene(
        session.reference.read("motion_time", "phase", "q"), session.measured.read("q")
    )
    # Without the user's own style, in which the layout might not hold.
    with style.context(["default", dict(_STYLE)]):
        figure = Figure(figsize=_INCHES, dpi=_DPI)
        _draw_head(figure, scene, session)
        _draw_panels(figure, scene, None if joints is None else _indices(joints))
    return figure


def _indices(joints: Sequence[str]) -> list[int]:
    unknown = [name for name in joints if name not in JOINT_NAMES]
    if unknown or not 0 < len(joints) <= 6:
        raise RecordingError(
            f"There is no joint {unknown[0]!r}." if unknown else f"{len(joints)} joints to plot.",
            f"Choose one to six of {', '.join(JOINT_NAMES)}.",
        )
    return [JOINT_NAMES.index(name) for name in joints]


def _draw_head(figure: Figure, scene: Scene, session: Session) -> None:
    from matplotlib.lines import Line2D

    name = (session.metadata.get("motion") or {}).get("name") or "unknown motion"
    figure.text(0.015, 0.965, name, fontsize=17, weight="bold")
    figures = [session.path.name, *_figures(scene)]
    if reason := (session.metadata.get("stream") or {}).get("reason"):
        figures.append(f"ended early: {textwrap.shorten(reason, 55, placeholder=' ...')}")
    figure.text(0.015, 0.937, "   ·   ".join(figures), color=_MUTED, fontsize=11)
    lines = [Line2D([], [], color=_MUTED, **_MEASURED), Line2D([], [], **_REFERENCE)]
    figure.legend(
        handles=lines, loc="upper right", bbox_to_anchor=(0.992, 0.972), ncols=2, fontsize=11
    )


def _figures(scene: Scene) -> list[str]:
    tracking, compared = scene.tracking, scene.compared
    if tracking is None:
        return ["no state came while the motion was played: there is nothing to compare"]
    delay = tracking.delay
    return [
        f"RMSE {np.degrees(pooled(tracking.rmse)):.2f}° over all joints",
        *([f"tracking delay {delay.seconds * 1e3:.1f} ms"] if delay else []),
        f"{len(compared.time)} states compared over {compared.duration:.1f} s",
    ]


def _draw_panels(figure: Figure, scene: Scene, joints: list[int] | None) -> None:
    cells = figure.add_gridspec(
        3, 3, left=0.045, right=0.985, top=0.885, bottom=0.055, wspace=0.16, hspace=0.34
    )
    busiest, others = joints_to_show(scene) if joints is None else (joints, [])
    for i, joint in enumerate([*busiest, *others]):
        axes = figure.add_subplot(cells[divmod(i, 3)])
        _draw_joint(axes, scene, joint)
        remark = ", worst of the others" if joint in others else ""
        axes.set_title(JOINT_NAMES[joint].removesuffix("_joint") + remark, weight="bold")
    _draw_error(figure.add_subplot(cells[2, :2]), scene)
    if scene.tracking:
        _draw_bars(figure.add_subplot(cells[2, 2]), scene.tracking)


def _draw_joint(axes: Axes, scene: Scene, joint: int) -> None:
    first, last = scene.view
    seen = (scene.state_times >= first) & (scene.state_times <= last)
    asked = (scene.times >= first) & (scene.times <= last)
    colour = _COLOURS[_GROUP_OF[joint]]
    axes.plot(scene.state_times[seen], scene.measured[seen, joint], color=colour, **_MEASURED)
    axes.plot(scene.times[asked], scene.asked[asked, joint], **_REFERENCE)
    if scene.tracking:
        rmse, largest = np.degrees((scene.tracking.rmse[joint], scene.tracking.max_abs[joint]))
        axes.set_title(f"RMSE {rmse:.2f}°, max {largest:.1f}°", loc="right", color=_MUTED)
    axes.set_ylabel("angle, deg")
    axes.margins(y=0.1)
    _shade_phases(axes, scene)
    _set_times(axes, first, last)


def _draw_error(axes: Axes, scene: Scene) -> None:
    first, last = scene.phases[0].start_s, scene.phases[-1].end_s
    axes.set_title("RMS error of each limb", weight="bold")
    axes.set_ylabel("deg")
    _shade_phases(axes, scene)
    _name_phases(axes, scene)
    _set_times(axes, first, last)
    if scene.tracking is None:
        return
    for group, joints in JOINT_GROUPS.items():
        times, error = binned_rms(scene.error_times, scene.error[:, joints])
        axes.plot(times, error, color=_COLOURS[group], linewidth=1.6, label=group.replace("_", " "))
    axes.set_ylim(0.0, 1.12 * axes.get_ylim()[1])
    if scene.view != (first, last):
        axes.axvspan(*scene.view, ymax=0.03, color=_DARK, label="shown above")
    axes.legend(loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=len(JOINT_GROUPS) + 1)


def _draw_bars(axes: Axes, tracking: Tracking) -> None:
    rmse = np.degrees(tracking.rmse)
    axes.set_title("RMSE of each joint", weight="bold")
    axes.set_ylabel("deg")
    axes.grid(visible=False, axis="x")
    axes.set_xlim(-0.8, N_JOINTS - 0.2)
    # Room for the names above the bars.
    axes.set_ylim(0.0, 1.45 * float(rmse.max()) or 1.0)
    for group, joints in JOINT_GROUPS.items():
        axes.bar(joints, rmse[list(joints)], color=_COLOURS[group], width=0.75)
    for joint, name in enumerate(JOINT_NAMES):
        part = name.removeprefix("left_").removeprefix("right_").removesuffix("_joint")
        _annotate(axes, part, (joint, rmse[joint]), 3, rotation=90, va="bottom", fontsize=7.5)
    axes.set_xticks(
        [float(np.mean(joints)) for joints in JOINT_GROUPS.values()],
        [f"{group.replace('_', ' ')}\n{value:.2f}°" for group, value in by_group(rmse).items()],
    )
    axes.tick_params(axis="x", length=0)


def _shade_phases(axes: Axes, scene: Scene) -> None:
    for one in scene.phases:
        if one.phase in _SHADES:
            axes.axvspan(one.start_s, one.end_s, color=_SHADES[one.phase], linewidth=0)


def _name_phases(axes: Axes, scene: Scene) -> None:
    narrow = _NARROW * (scene.phases[-1].end_s - scene.phases[0].start_s)
    for one in scene.phases:
        if one.duration_s > narrow:
            place = ((one.start_s + one.end_s) / 2.0, 1.0)
            _annotate(
                axes, one.phase.name, place, -4, xycoords=axes.get_xaxis_transform(), va="top"
            )


def _set_times(axes: Axes, first: float, last: float) -> None:
    axes.set_xlim(first, last)
    axes.set_xlabel("time since the motion began, s")
    axes.locator_params(axis="x", nbins=10, steps=(1, 2, 5, 10))


def _annotate(
    axes: Axes, text: str, place: tuple[float, float], points_above: float, **how: Any
) -> None:
    how = {"fontsize": 8, **how}
    offset = (0, points_above)
    axes.annotate(text, place, offset, textcoords="offset points", ha="center", color=_MUTED, **how)


def _save(figure: Figure, path: Path) -> None:
    with complete_file(path) as temporary:
        figure.savefig(temporary, format="png")
