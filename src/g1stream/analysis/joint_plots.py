"""The figure of some joints: a panel for each of them and each quantity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from g1stream.analysis.plot_style import (
    COLOURS,
    DARK,
    GROUP_OF,
    MUTED,
    STYLE,
    set_times,
    shade_phases,
)
from g1stream.analysis.signals import min_max, signal
from g1stream.errors import RecordingError
from g1stream.robot.joints import JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from g1stream.analysis.signals import Quantity, Signal
    from g1stream.session.session import Session

__all__ = ["plot_joints"]

#: Of a panel, and what the figure needs above the panels for its title, inches.
_WIDTH, _HEIGHT, _HEAD = 7.0, 1.7, 0.5
_DPI: Final = 100
_MOST_POINTS: Final = 4000
_ASKED: Final[dict[str, Any]] = {
    "color": DARK,
    "linewidth": 1.0,
    "linestyle": (0, (4, 2)),
    "zorder": 3,
}


def plot_joints(session: Session, joints: Sequence[int], what: Sequence[Quantity]) -> Figure:
    """A row for each joint and a column for each quantity, over time, with the phases shaded.

    Args:
        session: any; what it lacks is not drawn.
        joints: indices, motor order.
        what: quantities.

    Raises:
        RecordingError: the session has nothing of these quantities.
    """
    from matplotlib import style
    from matplotlib.figure import Figure

    signals = [signal(session, quantity) for quantity in what]
    if not any(one.lines for one in signals):
        raise RecordingError(
            f"{session.path} has nothing to plot of {', '.join(one.title for one in signals)}.",
            "Record while a robot, or a simulator, publishes its state and a motion is streamed.",
        )
    ends = [line.time[[0, -1]] for one in signals for line in one.lines]
    first, last = min(float(one[0]) for one in ends), max(float(one[1]) for one in ends)
    phases = session.phases
    with style.context(["default", dict(STYLE)]):
        size = (_WIDTH * len(signals), _HEIGHT * len(joints) + _HEAD)
        figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
        figure.suptitle(session.path.name, color=MUTED)
        panels = figure.subplots(len(joints), len(signals), squeeze=False, sharex=True)
        for row, joint in zip(panels, joints, strict=True):
            for axes, one in zip(row, signals, strict=True):
                _draw(axes, one, joint)
                shade_phases(axes, phases)
        for axes, one in zip(panels[0], signals, strict=True):
            if one.lines:
                axes.legend(loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=2)
        for axes in panels[-1]:
            set_times(axes, first, last)
    return figure


def _draw(axes: Axes, drawn: Signal, joint: int) -> None:
    axes.set_title(JOINT_NAMES[joint].removesuffix("_joint"), weight="bold")
    axes.set_ylabel(drawn.label)
    for line in drawn.lines:
        values = line.values[:, joint]
        shown = min_max(values, _MOST_POINTS)
        solid: dict[str, Any] = {"color": COLOURS[GROUP_OF[joint]], "linewidth": 1.6}
        how = _ASKED if line is not drawn.lines[-1] else solid
        axes.plot(line.time[shown], values[shown], label=line.name, **how)
