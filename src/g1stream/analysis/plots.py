"""The figure of a session: reference and measured joint positions, and the tracking error."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.analysis.joint_plots import plot_joints
from g1stream.analysis.plot_style import (
    COLOURS,
    DARK,
    GROUP_OF,
    MUTED,
    STYLE,
    set_times,
    shade_phases,
)
from g1stream.analysis.signals import chosen_quantities
from g1stream.analysis.tracking import NothingToCompareError
from g1stream.errors import RecordingError
from g1stream.files import save_figure
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.session.info import MotionInfo
from g1stream.session.records import read_record
from g1stream.session.stream_summary import StreamSummary
from g1stream.session.streams import Measured, Reference
from g1stream.text import counted
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from g1stream.analysis.tracking import Tracking
    from g1stream.session.session import Session
    from g1stream.session.summary import PhaseInterval

__all__ = ["LONGEST_VIEW", "draw", "plot"]

LONGEST_VIEW: Final = 20.0
"""A longer session shows its joints for so long only, around the greatest error, s."""

_NARROWEST_BIN: Final = 0.1
_MOST_BINS: Final = 200
_PANELS: Final = 6
_COMPARED: Final = (Reference.topic, Measured.topic)

_INCHES: Final = (16.0, 10.0)
_DPI: Final = 100

#: A phase that takes less of the width than this is not named in the figure.
_NARROW: Final = 0.04

_MEASURED: Final[Mapping[str, Any]] = {"label": "measured", "linewidth": 2.0}
_REFERENCE: Final[Mapping[str, Any]] = {
    "label": "reference",
    "linewidth": 1.1,
    "linestyle": (0, (4, 2)),
    "color": DARK,
}


@dataclass(frozen=True)
class _Data:
    """What is drawn: times are s on the motion's clock, angles degrees.

    Attributes:
        times, reference: (N,) and (N, 29); nan in DAMP, where no position is commanded.
        state_times, measured: (M,) and (M, 29).
        phases: in order.
        tracking: None where there is nothing to compare.
        view: from when to when the joints are shown.
    """

    times: Floats
    reference: Floats
    state_times: Floats
    measured: Floats
    phases: list[PhaseInterval]
    tracking: Tracking | None
    view: tuple[float, float]

    @classmethod
    def of(cls, session: Session) -> _Data:
        try:
            tracking = session.tracking()
        except NothingToCompareError:
            tracking = None
        reference, measured = session.reference.read("phase", "q"), session.measured.read("q")
        damping = (reference.phase == Phase.DAMP)[:, np.newaxis]
        phases = session.phases
        return cls(
            times=reference.time,
            reference=np.where(damping, np.nan, np.degrees(reference.q)),
            state_times=measured.time,
            measured=np.degrees(measured.q),
            phases=phases,
            tracking=tracking,
            view=_view(phases[0].start_s, phases[-1].end_s, tracking),
        )


def draw(
    session: Session,
    path: str | Path,
    joints: Sequence[str] | str | None = None,
    what: Sequence[str] | None = None,
    *,
    force: bool = True,
) -> None:
    """Write the figure of a session, see `Session.plot`, to a PNG, SVG or PDF.

    The file appears when it is complete; `force`: one that exists already is replaced.

    Raises:
        ConfigError: the path has another suffix, or there is no such quantity.
        RecordingError: there is nothing to plot, no such joint, or the file cannot be written.
    """
    from matplotlib import style

    with style.context(["default", dict(STYLE)]):
        save_figure(lambda: plot(session, joints, what), Path(path), force=force)


def plot(
    session: Session, joints: Sequence[str] | str | None = None, what: Sequence[str] | None = None
) -> Figure:
    """See `Session.plot`."""
    chosen = None if joints is None else _indices(joints)
    overview = chosen is None or len(chosen) <= _PANELS
    if overview and what is None and all(map(session.topics.get, _COMPARED)):
        return _overview(session, chosen)
    all_joints = range(N_JOINTS)
    return plot_joints(session, chosen or all_joints, chosen_quantities(what or ("q",)))


def _overview(session: Session, joints: list[int] | None) -> Figure:
    """The joints, or those that move most, the error over time and each joint's RMSE."""
    from matplotlib import style
    from matplotlib.figure import Figure

    data = _Data.of(session)
    shown, worst = _joints_to_show(data) if joints is None else (joints, None)
    # Without the user's own style, in which the layout might not hold.
    with style.context(["default", dict(STYLE)]):
        figure = Figure(figsize=_INCHES, dpi=_DPI)
        _draw_head(figure, data, session)
        _draw_panels(figure, data, shown, worst)
    return figure


def _indices(joints: Sequence[str] | str) -> list[int]:
    """The joints whose names match, each once, in the order of the patterns."""
    found: dict[int, None] = {}
    for pattern in [joints] if isinstance(joints, str) else joints:
        try:
            named = re.compile(f"(?:{pattern})(?:_joint)?")
        except re.error as error:
            raise RecordingError(
                f"{pattern!r} is no regular expression: {error}.", "Name a joint, or left_.*"
            ) from error
        matching = [i for i, name in enumerate(JOINT_NAMES) if named.fullmatch(name)]
        if not matching:
            close = get_close_matches(pattern, JOINT_NAMES) or JOINT_NAMES
            raise RecordingError(
                f"There is no joint {pattern!r}.", f"Choose from {', '.join(close)}."
            )
        found |= dict.fromkeys(matching)
    if not found:
        raise RecordingError("There is no joint to plot.", "Name one, or leave the joints out.")
    return list(found)


def _joints_to_show(data: _Data) -> tuple[list[int], int | None]:
    """Of each limb the joint with the widest range, and the worst of the others, if known."""
    tracking = data.tracking
    span = np.ptp(tracking.reference if tracking else data.reference, axis=0)
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
    """RMS of errors (K, J) at times (K,) in bins of 0.1 s, or in 200 bins of a longer session.

    Returns:
        the middle of each bin (B,) and its RMS (B,), nan where it is empty.
    """
    width = max(_NARROWEST_BIN, float(times[-1] - times[0]) / _MOST_BINS)
    edges = times[0] + width * np.arange(int((times[-1] - times[0]) / width) + 2)
    counts, _ = np.histogram(times, edges)
    sums, _ = np.histogram(times, edges, weights=np.square(errors).mean(axis=1))
    mean_squares = np.divide(sums, counts, out=np.full(len(counts), np.nan), where=counts > 0)
    return (edges[:-1] + edges[1:]) / 2.0, np.sqrt(mean_squares)


def _draw_head(figure: Figure, data: _Data, session: Session) -> None:
    from matplotlib.lines import Line2D

    motion, _ = read_record(MotionInfo, session.metadata.get("motion"))
    stream, _ = read_record(StreamSummary, session.metadata.get("stream"))
    name = (motion and motion.name) or "unknown motion"
    figure.text(0.015, 0.965, name, fontsize=17, weight="bold")
    facts = [session.path.name, *_facts(data.tracking)]
    if stream and stream.reason:
        facts.append(f"ended early: {textwrap.shorten(stream.reason, 55, placeholder=' ...')}")
    figure.text(0.015, 0.937, "   ·   ".join(facts), color=MUTED, fontsize=11)
    lines = [Line2D([], [], color=MUTED, **_MEASURED), Line2D([], [], **_REFERENCE)]
    figure.legend(
        handles=lines, loc="upper right", bbox_to_anchor=(0.992, 0.972), ncols=2, fontsize=11
    )


def _facts(tracking: Tracking | None) -> list[str]:
    if tracking is None:
        return ["no state in PLAY: nothing to compare"]
    delay = tracking.delay
    return [
        f"RMSE {np.degrees(tracking.overall):.2f}° over "
        + ("all joints" if len(tracking.joints) == N_JOINTS else f"{len(tracking.joints)} joints"),
        *([f"tracking delay {delay.seconds * 1e3:.1f} ms"] if delay else []),
        f"{counted(len(tracking.time), 'state')} compared over {tracking.duration:.1f} s",
    ]


def _draw_panels(figure: Figure, data: _Data, joints: list[int], worst: int | None) -> None:
    cells = figure.add_gridspec(
        3, 3, left=0.045, right=0.985, top=0.885, bottom=0.055, wspace=0.16, hspace=0.34
    )
    rows = 1 if len(joints) <= 3 else 2
    panels = cells[:2, :].subgridspec(rows, -(-len(joints) // rows), wspace=0.16, hspace=0.34)
    for i, joint in enumerate(joints):
        axes = figure.add_subplot(panels[divmod(i, panels.ncols)])
        _draw_joint(axes, data, joint)
        axes.set_title(JOINT_NAMES[joint].removesuffix("_joint"), weight="bold")
        if joint == worst:  # below the title, whose line has no room beside the figures
            _annotate(
                axes, "worst of the others", (0.5, 1.0), -4, xycoords="axes fraction", va="top"
            )
    _draw_error(figure.add_subplot(cells[2, :2]), data)
    if data.tracking:
        _draw_bars(figure.add_subplot(cells[2, 2]), data.tracking)


def _draw_joint(axes: Axes, data: _Data, joint: int) -> None:
    first, last = data.view
    seen = (data.state_times >= first) & (data.state_times <= last)
    asked = (data.times >= first) & (data.times <= last)
    colour = COLOURS[GROUP_OF[joint]]
    axes.plot(data.state_times[seen], data.measured[seen, joint], color=colour, **_MEASURED)
    axes.plot(data.times[asked], data.reference[asked, joint], **_REFERENCE)
    if data.tracking:
        rmse, largest = np.degrees((data.tracking.rmse[joint], data.tracking.max_abs[joint]))
        axes.set_title(f"RMSE {rmse:.2f}°, max {largest:.1f}°", loc="right", color=MUTED)
    axes.set_ylabel("angle, deg")
    axes.margins(y=0.1)
    shade_phases(axes, data.phases)
    set_times(axes, first, last)


def _draw_error(axes: Axes, data: _Data) -> None:
    first, last = data.phases[0].start_s, data.phases[-1].end_s
    axes.set_title("RMS error of each limb", weight="bold")
    axes.set_ylabel("deg")
    shade_phases(axes, data.phases)
    _name_phases(axes, data)
    set_times(axes, first, last)
    if data.tracking is None:
        return
    error = np.degrees(data.tracking.error)
    for group, joints in data.tracking.limbs.items():
        times, rms = _binned_rms(data.tracking.time, error[:, joints])
        axes.plot(times, rms, color=COLOURS[group], linewidth=1.6, label=group.replace("_", " "))
    axes.set_ylim(0.0, 1.12 * axes.get_ylim()[1])
    if data.view != (first, last):
        axes.axvspan(*data.view, ymax=0.03, color=DARK, label="shown above")
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


def _name_phases(axes: Axes, data: _Data) -> None:
    narrow = _NARROW * (data.phases[-1].end_s - data.phases[0].start_s)
    for one in data.phases:
        if one.duration_s > narrow:
            place = ((one.start_s + one.end_s) / 2.0, 1.0)
            _annotate(
                axes, one.phase.name, place, -4, xycoords=axes.get_xaxis_transform(), va="top"
            )


def _annotate(
    axes: Axes, text: str, place: tuple[float, float], points_above: float, **how: Any
) -> None:
    how = {"fontsize": 8, **how}
    offset = (0, points_above)
    axes.annotate(text, place, offset, textcoords="offset points", ha="center", color=MUTED, **how)
