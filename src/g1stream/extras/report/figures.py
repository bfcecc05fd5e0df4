"""Data of a report's figures for the page's script: signals, events and histograms.

Times are in s on the motion's clock. Signals are reduced by `min_max`, so that a page does not grow
with the length of a session and no peak is lost.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from g1stream.analysis.metrics import Metrics
from g1stream.analysis.plots import COLOURS, SHADES
from g1stream.analysis.signals import Quantity, Signal, min_max, signal
from g1stream.analysis.summary import Summary
from g1stream.app.session import Session
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES, N_JOINTS
from g1stream.session.streams import CommandStream, MeasuredStream
from g1stream.text import printable
from g1stream.types import Floats

_MOST_POINTS: Final = 2000
_MOST_EVENTS: Final = 500
_STEPS: Final = (1, 2, 3, 5, 7)
_QUANTITIES: Final[tuple[Quantity, ...]] = ("q", "error", "tau")


def figures(session: Session, summary: Summary, metrics: Metrics) -> dict[str, Any]:
    """Data of a session's figures, with the keys that report.js reads.

    Arrays are float32 in base64.
    """
    played = summary.tracking.joints if summary.tracking else JOINT_NAMES
    signals: dict[str, Any] = {}
    limbs: list[dict[str, Any]] = []
    for quantity in _QUANTITIES:
        for limb, joints in JOINT_GROUPS.items():  # all of a long session take much memory
            shown = signal(session, quantity, joints)
            _draw(shown, joints, signals.setdefault(quantity, {"label": shown.label, "lines": []}))
            if quantity == "error":
                limbs += _limb_error(shown, limb, [JOINT_NAMES[one] in played for one in joints])
    tracking, torque = summary.tracking, metrics.torque
    errors = (
        {name: math.degrees(one.rmse_rad) for name, one in tracking.joints.items()}
        if tracking
        else {}
    )
    limits = {name: one.limit_nm for name, one in torque.joints.items()} if torque else {}
    worst = tracking.worst[0] if tracking else ""
    return {
        "joints": [name.removesuffix("_joint") for name in JOINT_NAMES],
        "colours": [COLOURS[limb] for limb, joints in JOINT_GROUPS.items() for _ in joints],
        "rmse_deg": _of_each_joint(errors),
        "torque_limits": _of_each_joint(limits),
        "first_joint": JOINT_NAMES.index(worst) if worst else 0,  # initial selection
        "phases": [
            {
                "name": one.phase.name,
                "start": one.start_s,
                "end": one.end_s,
                "colour": SHADES.get(one.phase),
            }
            for one in summary.phases
        ],
        "events": _events(session),
        "signals": signals,
        "limbs": limbs,
        "intervals": _intervals(session),
        "lateness": _lateness(metrics),
        "steps": _steps(session),
    }


def _of_each_joint(values: Mapping[str, float]) -> list[float | None]:
    """Values in motor order; None for a joint without a value, empty without any value."""
    return [values.get(name) for name in JOINT_NAMES] if values else []


def _events(session: Session) -> list[dict[str, Any]]:
    """The log. A long one is shortened, with warnings and errors kept first."""
    log = sorted(session.log, key=lambda event: event.level in {"DEBUG", "INFO", "UNKNOWN"})
    return [
        {
            "time": (event.time_ns - session.start_ns) / 1e9,
            "level": event.level,
            "text": printable(f"{event.name}: {event.text}"),
        }
        for event in sorted(log[:_MOST_EVENTS], key=lambda event: event.time_ns)
    ]


def _draw(shown: Signal, joints: Sequence[int], drawn: dict[str, Any]) -> None:
    """Add the curves of some joints to those of the others."""
    lines: list[dict[str, Any]] = drawn["lines"]
    if not lines:
        lines += [{"name": one.name, "joints": [None] * N_JOINTS} for one in shown.lines]
    for line, one in zip(lines, shown.lines, strict=True):
        for joint, values in zip(joints, one.values.T, strict=True):
            line["joints"][joint] = curve(one.time, values)


def _limb_error(error: Signal, limb: str, played: Sequence[bool]) -> list[dict[str, Any]]:
    """The RMS error of a limb over time, of those of its joints that were played."""
    return [
        {
            "name": limb.replace("_", " "),
            "colour": COLOURS[limb],
            **curve(line.time, np.sqrt(np.mean(np.square(line.values[:, played]), axis=1))),
        }
        for line in error.lines
        if any(played)
    ]


def _intervals(session: Session) -> list[dict[str, Any]]:
    """The intervals between publish times, ms. Gaps and stalls appear as peaks."""
    kinds = [kind for kind in (CommandStream, MeasuredStream) if session.topics.get(kind.topic)]
    times = {kind.topic: np.sort(session.stream(kind).time) for kind in kinds}
    return [
        {"name": topic, **curve(at[1:], np.diff(at) * 1e3)}
        for topic, at in times.items()
        if len(at) > 1
    ]


def _steps(session: Session) -> list[dict[str, Any]]:
    """The delays of each policy step, ms; empty without a policy."""
    steps = session.policy
    if steps is None or len(steps) < 2:
        return []
    lines = {
        "between steps": np.append(np.nan, np.diff(steps.time)),
        "from LowState to command": steps.delay,
        "inference": steps.inference_time,
    }
    return [
        {"name": name, **curve(steps.time[ok], 1e3 * values[ok])}
        for name, values in lines.items()
        if (ok := np.isfinite(values)).any()
    ]


def _lateness(metrics: Metrics) -> list[dict[str, Any]]:
    """Number of ticks by lateness, in bins of growing width: 10 to 20 us, 20 to 30, 30 to 50 ..."""
    histogram = metrics.timing.lateness_histogram_us or {}
    if not histogram:
        return []
    edges = [0]
    while edges[-1] <= max(histogram):
        decade, step = divmod(len(edges) - 1, len(_STEPS))
        edges.append(_STEPS[step] * 10**decade)
    late = [max(us, 0) for us in histogram]
    ticks, _ = np.histogram(late, edges, weights=list(histogram.values()))
    bins = [
        {"us": f"{first}\N{EN DASH}{end}", "ticks": int(n)}
        for first, end, n in zip(edges[:-1], edges[1:], ticks, strict=True)
    ]
    return bins[int((ticks > 0).argmax()) :]


def curve(times: Floats, values: Floats, most: int = _MOST_POINTS) -> dict[str, str]:
    """A line of a figure: about `most` samples that show its peaks."""
    shown = min_max(values, most)
    return {"x": _packed(times[shown]), "y": _packed(values[shown])}


def _packed(values: Floats) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()
