"""A layout for the Rerun viewer, which calls it a blueprint; entities as in `rerun_log`."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from g1stream.optional import import_extra
from g1stream.text import short_name

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["APPLICATION", "import_rerun", "rerun_layout", "rerun_layout_file"]

APPLICATION: Final = "g1stream"
"""The application id of all recordings: a blueprint is for one application."""

#: Where the camera is from the pelvis, m: before the robot, on its left.
_EYE: Final = (1.6, 1.0, 0.3)


def import_rerun() -> Any:
    """The package rerun.

    Raises:
        ConfigError: it is not installed.
    """
    return import_extra("rerun", "rerun", "A view in Rerun needs Python 3.11 or later and")


def rerun_layout_file(joints: Sequence[str]) -> bytes:
    """The content of a .rbl file with a layout for sessions.

    Args:
        joints: as for `rerun_layout`.

    Raises:
        ConfigError: Rerun is not installed.
    """
    blueprint = rerun_layout(joints)
    with TemporaryDirectory() as directory:
        path = Path(directory, "layout.rbl")
        blueprint.save(APPLICATION, path)
        return path.read_bytes()


def rerun_layout(joints: Sequence[str], *, live: bool = False) -> Any:
    """A layout, as a `rerun.blueprint.Blueprint`.

    Args:
        joints: names of the joints to plot, at best six.
        live: follow what comes in, and plot the last 10 s.

    Raises:
        ConfigError: Rerun is not installed.
    """
    import_rerun()
    import rerun.blueprint as rrb

    last = rrb.TimeRangeBoundary.cursor_relative(seconds=-10.0)
    now = rrb.TimeRangeBoundary.cursor_relative()
    recent = [rrb.VisibleTimeRange("publish_time", start=last, end=now)] if live else None

    def plot(name: str, contents: Any, *, legend: bool = True) -> Any:
        return rrb.TimeSeriesView(
            name=name,
            contents=contents,
            plot_legend=rrb.PlotLegend(visible=legend),
            axis_x=rrb.TimeAxis(link="LinkToGlobal"),
            time_ranges=recent,
        )

    def grid(name: str, what: str, unit: str) -> Any:
        plots = [
            plot(f"{short_name(joint)}, {unit}", f"/joints/{joint}/{what}/**", legend=False)
            for joint in joints
        ]
        return rrb.Grid(*plots, grid_columns=2, name=name)

    robot = rrb.Spatial3DView(
        name="measured robot; blue: reference joints on the measured pelvis",
        contents=["/measured/**", "/ghost/**", "/reference/**"],
        overrides={"/reference": rrb.EntityBehavior(visible=False)},
        background=(32, 36, 43),
        line_grid=rrb.LineGrid3D(spacing=0.5),
        eye_controls=rrb.EyeControls3D(position=_EYE, tracking_entity="/measured/pelvis"),
    )
    errors = [f"/joints/{joint}/error" for joint in joints]
    timing = [
        "/timing/commands/interval",
        "/timing/commands/latency",
        "/timing/states/interval",
    ]
    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    left = rrb.Vertical(
        robot,
        rrb.StateTimelineView(name="phase", contents="/phase"),
        rrb.TextLogView(name="log", contents="/log/**", columns=columns),
        row_shares=[6, 1, 2],
    )
    right = rrb.Vertical(
        rrb.Tabs(
            grid("Positions", "position", "rad"),
            plot("Errors, rad", errors),
            grid("Torques", "torque", "N·m"),
        ),
        plot("tracking error by limb, RMS, rad", "/error/**"),
        plot("longest interval and latency, ms", timing),
        row_shares=[5, 2, 2],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[46, 54]),
        rrb.TimePanel(
            state="collapsed",
            timeline="publish_time" if live else "time",
            play_state="following" if live else "playing",
            loop_mode=None if live else "all",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
