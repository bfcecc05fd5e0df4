"""The figures of a session: an overview with the tracking error, and panels of some joints."""

from __future__ import annotations

import textwrap
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.analysis.signals import chosen_quantities, min_max, signal
from g1stream.analysis.tracking import UNSURE, NothingToCompareError, tracking
from g1stream.errors import RecordingError
from g1stream.files import check_suffix, complete_file
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS, matching_joints
from g1stream.session.records import MotionInfo, StreamSummary, read_record
from g1stream.session.streams import MeasuredStream, ReferenceStream
from g1stream.text import counted
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from g1stream.analysis.signals import Quantity, Signal
    from g1stream.analysis.tracking import Tracking
    from g1stream.session.recording import Recording
    from g1stream.session.records import PhaseInterval

__all__ = ["COLOURS", "LONGEST_VIEW", "SHADES", "draw", "plot"]

_DARK, _MUTED, _PALE = "#1a1a1a", "#5f6670", "#d5d9de"
COLOURS: Final = dict(
    zip(JOINT_GROUPS, ("#0072b2", "#56b4e9", "#009e73", "#d55e00", "#cc79a7"), strict=True)
)
_GROUP_OF: Final = {joint: group for group, joints in JOINT_GROUPS.items() for joint in joints}
SHADES: Final = {Phase.RAMP: "#eef1f5", Phase.HOLD: "#eef1f5", Phase.DAMP: "#f8e9e7"}
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

LONGEST_VIEW: Final = 20.0
"""Longest time for which the joints of a session are shown, around the largest error, s."""

_NARROWEST_BIN: Final = 0.1
_MOST_BINS: Final = 200
_PANELS: Final = 6
_COMPARED: Final = (ReferenceStream.topic, MeasuredStream.topic)

#: Size of the overview; size of another figure's panel, and of the space above panels, inches.
_INCHES: Final = (16.0, 10.0)
_PANEL_WIDTH, _PANEL_HEIGHT, _HEAD = 7.0, 1.7, 0.5
#: Height of panels, inches, and least width of a figure, panels.
_TALL_PANEL, _LEAST_WIDTH = 2.4, 1.5
_DPI: Final = 100
_MOST_POINTS: Final = 4000

#: Phases with a smaller fraction of the width have no name in the figure.
_NARROW: Final = 0.04

_SIMULATED: Final = {"color": "#c2185b", "linewidth": 1.2}
_ASKED: Final[Mapping[str, Any]] = {
    "color": _DARK,
    "linewidth": 1.0,
    "linestyle": (0, (4, 2)),
    "zorder": 3,
}


def draw(
    session: Recording,
    path: str | Path,
    joints: Sequence[str] | str | None = None,
    what: Sequence[str] | None = None,
    *,
    force: bool = True,
) -> None:
    """Write the figure of a session, see `Session.plot`, to a PNG, SVG or PDF.

    The file appears when it is complete. `force` replaces an existing file.

    Raises:
        ConfigError: the suffix, the quantity or a joint is unknown.
        RecordingError: there is nothing to plot, or the file cannot be written.
    """
    from matplotlib import style

    path = Path(path)
    check_suffix(path, "a figure", ".png", ".svg", ".pdf")
    with style.context(["default", dict(_STYLE)]), complete_file(path, force=force) as temporary:
        plot(session, joints, what).savefig(temporary, format=path.suffix[1:].lower())


def plot(
    session: Recording, joints: Sequence[str] | str | None = None, what: Sequence[str] | None = None
) -> Figure:
    """See `Session.plot`."""
    from matplotlib import style

    if isinstance(joints, str):
        joints = joints.split(",")
    chosen = None
    if joints is not None:
        named = (matching_joints(one.strip(), "In joints") for one in joints)
        chosen = list(dict.fromkeys(chain.from_iterable(named)))
    if chosen == []:
        raise RecordingError("There is no joint to plot.", "Name a joint, or omit the joints.")
    overview = chosen is None or len(chosen) <= _PANELS
    # Without the user's own style, which could break the layout.
    with style.context(["default", dict(_STYLE)]):
        if overview and what is None and session.phases and all(map(session.topics.get, _COMPARED)):
            return _overview(session, chosen)
        quantities = chosen_quantities(what or ("q",))
        return _plot_joints(session, chosen or range(N_JOINTS), quantities)


def _overview(session: Recording, joints: list[int] | None) -> Figure:
    """The joints, or those that move most, the error over time and each joint's RMSE."""
    from matplotlib.figure import Figure

    try:
        followed = tracking(session)
    except NothingToCompareError:
        followed = None
    whole = session.phases[0].start_s, session.phases[-1].end_s
    shown, worst = _joints_to_show(session, followed) if joints is None else (joints, None)
    view = _view(*whole, followed)
    figure = Figure(figsize=_INCHES, dpi=_DPI)
    _draw_head(figure, session, followed)
    cells = figure.add_gridspec(
        3, 3, left=0.045, right=0.985, top=0.885, bottom=0.055, wspace=0.16, hspace=0.34
    )
    rows = 1 if len(shown) <= 3 else 2
    panels = cells[:2, :].subgridspec(rows, -(-len(shown) // rows), wspace=0.16, hspace=0.34)
    angles = signal(session, "q")
    for i, joint in enumerate(shown):
        axes = figure.add_subplot(panels[divmod(i, panels.ncols)])
        _draw_panel(axes, angles, joint, view)
        if followed:
            rmse, largest = np.degrees((followed.rmse[joint], followed.max_abs[joint]))
            axes.set_title(f"RMSE {rmse:.2f}°, max {largest:.1f}°", loc="right", color=_MUTED)
        axes.margins(y=0.1)
        _shade_phases(axes, session.phases)
        _set_times(axes, *view)
        if joint == worst:  # below the title, because the title's line has no room
            _annotate(
                axes, "worst of the others", (0.5, 1.0), -4, xycoords="axes fraction", va="top"
            )
    _draw_error(figure.add_subplot(cells[2, :2]), session, followed, view)
    if followed:
        _draw_bars(figure.add_subplot(cells[2, 2]), followed)
    return figure


def _joints_to_show(session: Recording, tracking: Tracking | None) -> tuple[list[int], int | None]:
    """The joint with the widest range of each limb, and the worst other joint, if known."""
    span = np.ptp(tracking.reference if tracking else session.reference.q, axis=0)
    limbs = tracking.limbs if tracking else JOINT_GROUPS
    widest = [max(joints, key=lambda joint: float(span[joint])) for joints in limbs.values()]
    others = {*tracking.joints} - {*widest} if tracking else {}
    if tracking is None or not others:
        return widest, None
    worst = max(others, key=lambda joint: float(tracking.rmse[joint]))
    return [*widest, worst], worst


def _view(first: float, last: float, tracking: Tracking | None) -> tuple[float, float]:
    if last - first <= LONGEST_VIEW or tracking is None:
        return first, last
    error = tracking.error[:, list(tracking.joints)]
    worst = float(tracking.time[np.abs(error).max(axis=1).argmax()])
    start = min(max(worst - LONGEST_VIEW / 2.0, first), last - LONGEST_VIEW)
    return start, start + LONGEST_VIEW


def _binned_rms(times: Floats, errors: Floats) -> tuple[Floats, Floats]:
    """Centres (B,) of bins of 0.1 s or more, and RMS of errors (K, J) in each; nan if empty."""
    width = max(_NARROWEST_BIN, float(times[-1] - times[0]) / _MOST_BINS)
    edges = times[0] + width * np.arange(int((times[-1] - times[0]) / width) + 2)
    counts, _ = np.histogram(times, edges)
    sums, _ = np.histogram(times, edges, weights=np.square(errors).mean(axis=1))
    mean_squares = np.divide(sums, counts, out=np.full(len(counts), np.nan), where=counts > 0)
    return (edges[:-1] + edges[1:]) / 2.0, np.sqrt(mean_squares)


def _draw_head(figure: Figure, session: Recording, tracking: Tracking | None) -> None:
    from matplotlib.lines import Line2D

    motion, _ = read_record(MotionInfo, session.metadata.get("motion"))
    stream, _ = read_record(StreamSummary, session.metadata.get("stream"))
    name = (motion and motion.name) or "unknown motion"
    figure.text(0.015, 0.965, name, fontsize=17, weight="bold")
    facts = [session.path.name, "no state in PLAY: nothing to compare"]
    if tracking:
        n, delay = len(tracking.joints), tracking.delay
        if delay and (delay.ci95 or 0.0) > UNSURE:
            delay = None
        sure = f" ± {delay.ci95 * 1e3:.1f}" if delay and delay.ci95 else ""
        facts[1:] = [
            f"RMSE {np.degrees(tracking.overall):.2f}° over "
            + ("all joints" if n == N_JOINTS else f"{n} joints"),
            *([f"tracking delay {delay.seconds * 1e3:.1f}{sure} ms"] if delay else []),
            f"{counted(len(tracking.time), 'state')} compared over {tracking.duration:.1f} s",
        ]
    if stream and stream.reason:
        facts.append(f"ended early: {textwrap.shorten(stream.reason, 55, placeholder=' ...')}")
    figure.text(0.015, 0.937, "   ·   ".join(facts), color=_MUTED, fontsize=11)
    measured = Line2D([], [], color=_MUTED, linewidth=1.6, label="measured")
    lines = [measured, Line2D([], [], label="reference", **_ASKED)]
    figure.legend(
        handles=lines, loc="upper right", bbox_to_anchor=(0.992, 0.972), ncols=2, fontsize=11
    )


def _draw_error(
    axes: Axes, session: Recording, tracking: Tracking | None, view: tuple[float, float]
) -> None:
    phases = session.phases
    first, last = phases[0].start_s, phases[-1].end_s
    axes.set_title("RMS error of each limb", weight="bold")
    axes.set_ylabel("deg")
    _shade_phases(axes, phases)
    for one in phases:
        if one.duration_s > _NARROW * (last - first):
            place, where = ((one.start_s + one.end_s) / 2.0, 1.0), axes.get_xaxis_transform()
            _annotate(axes, one.phase.name, place, -4, xycoords=where, va="top")
    _set_times(axes, first, last)
    if tracking is None:
        return
    (line,) = signal(session, "error").lines
    top = 0.0
    for group, joints in tracking.limbs.items():
        error = line.values[:, joints]
        known = np.isfinite(error).all(axis=1)
        times, rms = _binned_rms(line.time[known], error[known])
        axes.plot(times, rms, color=COLOURS[group], linewidth=1.6, label=group.replace("_", " "))
        in_play = (times >= tracking.time[0]) & (times <= tracking.time[-1])
        top = np.fmax.reduce(rms[in_play], initial=top)
    axes.set_ylim(0.0, 1.2 * top or None)  # errors in RAMP may be larger
    if view != (first, last):
        axes.axvspan(*view, ymax=0.03, color=_DARK, label="shown above")
    axes.legend(loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=len(JOINT_GROUPS) + 1)


def _draw_bars(axes: Axes, tracking: Tracking) -> None:
    rmse = np.degrees(tracking.rmse)
    axes.set_title("RMSE of each joint", weight="bold")
    axes.set_ylabel("deg")
    axes.grid(visible=False, axis="x")
    axes.set_xlim(-0.8, N_JOINTS - 0.2)
    # Room for the names above the bars.
    axes.set_ylim(0.0, 1.5 * float(rmse[list(tracking.joints)].max()) or 1.0)
    for group, joints in tracking.limbs.items():
        axes.bar(joints, rmse[joints], color=COLOURS[group], width=0.75)
    for joint in tracking.joints:
        part = (
            JOINT_NAMES[joint].removeprefix("left_").removeprefix("right_").removesuffix("_joint")
        )
        _annotate(axes, part, (joint, rmse[joint]), 3, rotation=90, va="bottom", fontsize=7.5)
    axes.set_xticks(
        [float(np.mean(joints)) for joints in tracking.limbs.values()],
        [
            f"{group.replace('_', ' ')}\n{np.degrees(value):.2f}°"
            for group, value in tracking.rmse_by_limb.items()
        ],
    )
    axes.tick_params(axis="x", length=0)


def _annotate(
    axes: Axes, text: str, place: tuple[float, float], points_above: float, **how: Any
) -> None:
    how = {"fontsize": 8, **how}
    offset = (0, points_above)
    axes.annotate(text, place, offset, textcoords="offset points", ha="center", color=_MUTED, **how)


def _plot_joints(session: Recording, joints: Sequence[int], what: Sequence[Quantity]) -> Figure:
    """A row for each joint and a column for each quantity, over time, with the phases shaded.

    If there are fewer joints than quantities, joints are the columns, for a better shape.
    """
    from matplotlib.figure import Figure

    signals = [signal(session, quantity) for quantity in what]
    ends = [line.time[[0, -1]] for one in signals for line in one.lines if len(line.time)]
    if not ends:
        raise RecordingError(
            f"{session.path} has no data for {', '.join(one.title for one in signals)}.",
            "Record while a robot, or a simulator, publishes its state and a motion is streamed.",
        )
    first, last = min(float(one[0]) for one in ends), max(float(one[1]) for one in ends)
    phases = session.phases
    stacked = len(joints) < len(signals)
    shape = (len(signals), len(joints)) if stacked else (len(joints), len(signals))
    height = _TALL_PANEL if stacked else _PANEL_HEIGHT
    size = (_PANEL_WIDTH * max(shape[1], _LEAST_WIDTH), height * shape[0] + _HEAD)
    figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
    figure.suptitle(session.path.name, color=_MUTED)
    panels = figure.subplots(*shape, squeeze=False, sharex=True)
    by_joint = panels.T if stacked else panels
    for row, joint in zip(by_joint, joints, strict=True):
        for axes, one in zip(row, signals, strict=True):
            _draw_panel(axes, one, joint, (first, last))
            _shade_phases(axes, phases)
    for axes, one in zip(by_joint[0], signals, strict=True):
        if one.lines:
            axes.legend(loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=2)
    for axes in panels[-1]:
        _set_times(axes, first, last)
    return figure


def _draw_panel(axes: Axes, drawn: Signal, joint: int, view: tuple[float, float]) -> None:
    axes.set_title(JOINT_NAMES[joint].removesuffix("_joint"), weight="bold")
    axes.set_ylabel(drawn.label)
    for line in drawn.lines:
        seen = slice(*np.searchsorted(line.time, (view[0], np.nextafter(view[1], np.inf))))
        times, values = line.time[seen], line.values[seen, joint]
        shown = min_max(values, _MOST_POINTS)
        solid: dict[str, Any] = {"color": COLOURS[_GROUP_OF[joint]], "linewidth": 1.6}
        how = _ASKED if line is not drawn.lines[-1] else solid
        how = _SIMULATED if line.name == "simulated" else how
        axes.plot(times[shown], values[shown], label=line.name, **how)


def _shade_phases(axes: Axes, phases: Sequence[PhaseInterval]) -> None:
    """Shade the phases without playback."""
    for one in phases:
        if one.phase in SHADES:
            axes.axvspan(one.start_s, one.end_s, color=SHADES[one.phase], linewidth=0)


def _set_times(axes: Axes, first: float, last: float) -> None:
    """Name and limit the time axis, s."""
    axes.set_xlim(first, last)
    axes.set_xlabel("time since the motion began, s")
    axes.locator_params(axis="x", nbins=10, steps=(1, 2, 5, 10))
