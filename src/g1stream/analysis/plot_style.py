"""What all figures of a session share: colours, phases and the time axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from g1stream.robot.joints import JOINT_GROUPS
from g1stream.types import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from g1stream.session.summary import PhaseInterval

__all__ = ["COLOURS", "DARK", "GROUP_OF", "MUTED", "SHADES", "STYLE", "set_times", "shade_phases"]

DARK, MUTED, PALE = "#1a1a1a", "#5f6670", "#d5d9de"
COLOURS: Final = dict(
    zip(JOINT_GROUPS, ("#0072b2", "#56b4e9", "#009e73", "#d55e00", "#cc79a7"), strict=True)
)
GROUP_OF: Final = {joint: group for group, joints in JOINT_GROUPS.items() for joint in joints}
SHADES: Final = {Phase.RAMP: "#eef1f5", Phase.HOLD: "#eef1f5", Phase.DAMP: "#f8e9e7"}
STYLE: Final[Mapping[str, Any]] = {
    "font.size": 9,
    "axes.edgecolor": PALE,
    "axes.labelcolor": MUTED,
    "axes.titlecolor": DARK,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9ecef",
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.frameon": False,
}


def shade_phases(axes: Axes, phases: Sequence[PhaseInterval]) -> None:
    """Shade the phases in which nothing is played."""
    for one in phases:
        if one.phase in SHADES:
            axes.axvspan(one.start_s, one.end_s, color=SHADES[one.phase], linewidth=0)


def set_times(axes: Axes, first: float, last: float) -> None:
    """Name and limit the time axis, s."""
    axes.set_xlim(first, last)
    axes.set_xlabel("time since the motion began, s")
    axes.locator_params(axis="x", nbins=10, steps=(1, 2, 5, 10))
