"""The layout for Foxglove and Lichtblick: panels for the topics of a session."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from g1stream.robot.joints import JOINT_GROUPS
from g1stream.robot.model import G1
from g1stream.text import short_name
from g1stream.view.encoders import GHOST_PREFIX, MEASURED_PREFIX

if TYPE_CHECKING:
    from collections.abc import Sequence


__all__ = ["DEFAULT_JOINTS", "LIMB_COLORS", "MEASURED", "RED", "REFERENCE", "foxglove_layout"]

REFERENCE, MEASURED, RED = "#1abfff", "#ffa61a", "#f44336"
"""Colours of the reference, of measurements, and of limits."""

LIMB_COLORS: Final = ("#4e98e2", "#f5774d", "#a395e2", "#55d18c", "#f7df71")
"""Colours of `JOINT_GROUPS`."""

#: Robots and path in the 3D panel, and whether they are visible initially.
_SCENES: Final = {
    "/measured/scene": True,
    "/ghost/scene": True,
    "/measured/path": True,
    "/scene": False,
}

DEFAULT_JOINTS: Final = (
    "left_knee_joint",
    "right_knee_joint",
    "waist_yaw_joint",
    "left_shoulder_pitch_joint",
    "right_shoulder_pitch_joint",
    "left_elbow_joint",
)
"""Joints that are plotted without a session; a layout has space for this number of joints."""


def foxglove_layout(
    joints: Sequence[str],
    robot: G1 | None = None,
) -> dict[str, Any]:
    """Make a layout for Foxglove and Lichtblick, as JSON for their import.

    Args:
        joints: names of up to six joints to plot.
        robot: robot whose frames are hidden and whose torque limits are drawn; None: the default.
    """
    robot = robot or G1.default()
    panels: dict[str, Any] = {
        "3D!robot": _robot_panel(robot),
        "StateTransitions!phase": {
            **_title("phase"),
            "paths": [{"value": "/reference.phase", "label": "phase", **_BY_LOG_TIME}],
            "isSynced": True,
        },
        "RosOut!log": {
            **_title("log"),
            "searchTerms": [],
            "minLogLevel": 1,
            "topicToRender": "/log",
        },
        "Plot!limbs": _plot(
            "tracking error by limb, RMS, rad",
            [
                (_joint_path("/tracking_error/limbs", limb, "position"), limb, color)
                for limb, color in zip(JOINT_GROUPS, LIMB_COLORS, strict=True)
            ],
            legend=True,
        ),
        "Plot!timing": _plot(
            "longest interval and latency, ms",
            [
                ("/timing/commands.interval_ms", "command interval", REFERENCE),
                ("/timing/commands.latency_ms", "command latency", RED),
                ("/timing/states.interval_ms", "state interval", MEASURED),
            ],
            legend=True,
        ),
    }
    positions, torques = [], []
    for joint in joints:
        name = short_name(joint)
        position, torque = f"Plot!{joint}", f"Plot!{joint}-torque"
        limit = float(robot.torque_limit[robot.joint_names.index(joint)])
        panels[position] = _plot(
            f"{name}, rad",
            _curves(joint, "position", "reference", "measured"),
        )
        panels[torque] = _plot(
            f"{name}, N·m",
            [
                *_curves(joint, "effort", "feed-forward", "estimated"),
                (f"{limit:g}", "limit", RED),
                (f"{-limit:g}", "-limit", RED),
            ],
        )
        positions.append(position)
        torques.append(torque)
    tabs = [
        {"title": "Positions", "layout": _grid(positions)},
        {"title": "Torques", "layout": _grid(torques)},
    ]
    panels["Tab!joints"] = {"activeTabIdx": 0, "tabs": tabs}
    left = _column(("3D!robot", 74), ("StateTransitions!phase", 42), "RosOut!log")
    right = _column(("Tab!joints", 56), ("Plot!limbs", 50), "Plot!timing")
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": left, "second": right, "splitPercentage": 46},
    }


def _curves(joint: str, field: str, reference: str, measured: str) -> list[tuple[str, str, str]]:
    """A field of a joint in the reference and in the measurement, as labelled curves."""
    return [
        (_joint_path("/reference/joint_states", joint, field), reference, REFERENCE),
        (_joint_path("/measured/joint_states", joint, field), measured, MEASURED),
    ]


_BY_LOG_TIME: Final = {"enabled": True, "timestampMethod": "receiveTime"}


def _robot_panel(robot: G1) -> dict[str, Any]:
    """The 3D panel, without frames and labels, and with the camera beside the measured pelvis."""
    frames = [
        "world",
        *(
            f"{prefix}{link}"
            for prefix in ("", MEASURED_PREFIX, GHOST_PREFIX)
            for link in robot.link_names
        ),
    ]
    return {
        **_title("measured robot; blue: reference joints on the measured pelvis"),
        "cameraState": {
            "perspective": True,
            "distance": 2.6,
            "phi": 76,
            "thetaOffset": 55,
            "targetOffset": [0, 0, -0.05],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 40,
            "near": 0.05,
            "far": 200,
        },
        "followMode": "follow-position",
        "followTf": MEASURED_PREFIX + robot.link_names[0],
        "scene": {
            "backgroundColor": "#20242b",
            "transforms": {"showLabel": False, "axisScale": 0, "lineWidth": 0},
        },
        "transforms": {f"frame:{frame}": {"visible": False} for frame in frames},
        "topics": {topic: {"visible": visible} for topic, visible in _SCENES.items()},
        "layers": {
            "floor": {
                "instanceId": "floor",
                "layerId": "foxglove.Grid",
                "label": "Floor",
                "visible": True,
                "frameId": "world",
                "frameLocked": True,
                "size": 8,
                "divisions": 16,
                "lineWidth": 1,
                "color": "#8aa0b860",
                "position": [0, 0, 0],
                "rotation": [0, 0, 0],
                "order": 1,
            }
        },
    }


def _title(text: str) -> dict[str, str]:
    """The title of a panel, for Foxglove and for Lichtblick."""
    return {"foxglovePanelTitle": text, "lichtblickPanelTitle": text}


def _plot(
    title: str, series: Sequence[tuple[str, str, str]], *, legend: bool = False
) -> dict[str, Any]:
    """A plot of series (message path or constant, label, colour)."""
    return {
        **_title(title),
        "paths": [
            {"value": path, "label": label, "color": color, "lineSize": 1.5, **_BY_LOG_TIME}
            for path, label, color in series
        ],
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": legend,
        "legendDisplay": "left" if legend else "none",
        "showPlotValuesInLegend": False,
        "sidebarDimension": 190,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _joint_path(topic: str, joint: str, field: str) -> str:
    return f'{topic}.joints[:]{{name=="{joint}"}}.{field}'


def _grid(panels: Sequence[str]) -> Any:
    """Two columns of panels."""
    half = (len(panels) + 1) // 2
    columns = [_rows(part) for part in (panels[:half], panels[half:]) if part]
    if len(columns) < 2:
        return columns[0] if columns else None
    return {"direction": "row", "first": columns[0], "second": columns[1]}


def _rows(panels: Sequence[str]) -> Any:
    """A column of panels with the same height."""
    return _column(
        *((panel, 100 / (len(panels) - i)) for i, panel in enumerate(panels[:-1])), panels[-1]
    )


def _column(*panels: Any) -> Any:
    """A column of (panel, share of the remaining height, %), and a last panel."""
    *above, below = panels
    for panel, share in reversed(above):
        below = {
            "direction": "column",
            "first": panel,
            "second": below,
            "splitPercentage": share,
        }
    return below
