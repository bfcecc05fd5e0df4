"""The tables of the pages: columns, units, and their keys in the JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from g1stream.extras.physics.result import MotionPhysics, reasons
from g1stream.text import counted, short_name

if TYPE_CHECKING:
    from g1stream.types import StreamSupport

_DEG: Final = 180.0 / math.pi
#: Number of torques of each support, and of colliding links, that are shown.
_MOST_PEAKS: Final = 3
_MOST_PAIRS: Final = 12


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    title: str  # heading
    unit: str
    key: str  # key of the value in the row's data, with dots for nested keys
    form: str = ".0f"  # format specification of a number
    scale: float = 1.0  # factor from the unit of the JSON to the shown unit
    words: Mapping[str, str] | None = None  # replacements for text values


class Cell(NamedTuple):
    """A value in the report's JSON, its key there, and its displayed text."""

    value: str
    key: str
    text: str


class Table(NamedTuple):
    """A table of values, as the template `macros.html` draws it."""

    head: str  # heading of the first column, which has the names
    columns: Sequence[Column]  # the other columns
    # A name, and a cell for each column; None for an unknown value.
    rows: Sequence[tuple[str, Sequence[Cell | None]]]


_DELAYS: Final = (
    Column("delay", "ms", "delay_s", ".1f", 1e3),
    Column("± 95 %", "ms", "delay_ci95_s", ".1f", 1e3),
    Column("correlation", "", "correlation", ".4f"),
)
_RATES: Final = (
    Column("velocity RMSE", "rad/s", "velocity_rmse_rad_s", ".3f"),
    Column("acceleration RMSE", "rad/s²", "acceleration_rmse_rad_s2", ".2f"),
)
_ERRORS: Final = (
    Column("RMSE", "deg", "rmse_rad", ".3f", _DEG),
    Column("MAE", "deg", "mae_rad", ".3f", _DEG),
    Column("p99", "deg", "p99_rad", ".3f", _DEG),
    Column("worst", "deg", "max_abs_rad", ".2f", _DEG),
    Column("at", "s", "max_abs_at_s", ".2f"),
)
_LIMBS: Final = (
    *_ERRORS,
    Column("worst joint", "by RMSE", "worst_joint"),
    Column("bias", "deg", "bias_rad", ".3f", _DEG),
    *_DELAYS,
    *_RATES,
)
_JOINTS: Final = (*_ERRORS, Column("bias", "deg", "bias_rad", ".3f", _DEG), *_DELAYS, *_RATES)
_LINKS: Final = (
    Column("MPJPE", "mm", "mpjpe_mm", ".2f"),
    Column("p99", "mm", "p99_mm", ".2f"),
    Column("worst", "mm", "max_mm", ".2f"),
    Column("at", "s", "max_at_s", ".2f"),
    Column("E_vel", "mm/frame", "vel_mm_per_frame", ".3f"),
    Column("E_acc", "mm/frame²", "acc_mm_per_frame2", ".3f"),
)
_END_EFFECTORS: Final = (
    Column("position", "mm", "position_mm", ".2f"),
    Column("worst", "mm", "max_position_mm", ".2f"),
    Column("orientation", "deg", "orientation_rad", ".3f", _DEG),
)
_PELVIS: Final = (
    Column("orientation", "deg", "orientation_rad", ".3f", _DEG),
    Column("worst", "deg", "max_orientation_rad", ".2f", _DEG),
    Column("yaw rate", "rad/s", "yaw_rate_rad_s", ".3f"),
    Column("position", "mm", "position_mm", ".1f"),
    Column("worst", "mm", "max_position_mm", ".1f"),
    Column("at the end", "mm", "final_position_mm", ".1f"),
    Column("velocity", "m/s", "lin_vel_m_s", ".3f"),
)
_ALL_TORQUES: Final = (
    Column("RMS", "N·m", "rms_nm", ".2f"),
    Column("highest use", "%", "use", ".1f", 100.0),
    Column("of", "joint", "most_used"),
    Column("saturated", "% of states", "saturated", ".2f", 100.0),
    Column("commanded - estimated", "N·m RMS", "commanded_rmse_nm", ".2f"),
    Column("work ∫|τ dq|", "J", "work_j", ".1f"),
    Column("net ∫τ dq", "J", "net_work_j", ".1f"),
    Column("power", "W", "power_w", ".1f"),
)
_TORQUES: Final = (
    Column("limit", "N·m", "limit_nm", ".0f"),
    Column("RMS", "N·m", "rms_nm", ".2f"),
    Column("p99", "N·m", "p99_nm", ".2f"),
    Column("max", "N·m", "max_nm", ".2f"),
    Column("use", "p99, %", "use", ".1f", 100.0),
    Column("saturated", "%", "saturated", ".2f", 100.0),
    Column("commanded - estimated", "N·m RMS", "commanded_rmse_nm", ".2f"),
    Column("commanded beyond", "%", "commanded_beyond", ".2f", 100.0),
    Column("work", "J", "work_j", ".1f"),
    Column("net", "J", "net_work_j", ".1f"),
)
_PERCENTILES: Final = (
    Column("p50", "µs", "p50"),
    Column("p99", "µs", "p99"),
    Column("p99.9", "µs", "p99_9"),
    Column("max", "µs", "max"),
)
_MILLISECONDS: Final = tuple(
    replace(column, unit="ms", form=".2f", scale=1e3) for column in _PERCENTILES
)
_TERMS: Final = (
    Column("mean", "", "mean", ".3f"),
    Column("std", "", "std", ".3f"),
    Column("deviation", "own std, last second", "deviation", ".1f"),
    Column("of", "", "of"),
    Column("farthest", "std of the training", "trained_deviation", ".1f"),
    Column("beyond 5 of them", "% of steps", "beyond_training", ".2f", 100.0),
)
_TOPICS: Final = (
    Column("messages", "", "count"),
    Column("lost", "", "lost"),
    Column("rate", "Hz", "rate_hz", ".1f"),
    Column("gaps", "", "gaps"),
    Column("longest interval", "ms", "longest_interval_s", ".1f", 1e3),
    Column("latency p50", "µs", "latency_us.p50"),
    Column("p99", "µs", "latency_us.p99"),
    Column("max", "µs", "latency_us.max"),
    Column("clock offset", "ms", "clock_offset_s", ".1f", 1e3),
)
_SPACES: Final = {
    "world": "in the world",
    "root_relative": "without the pelvis's position",
    "pelvis_frame": "from the pelvis: joints alone",
}
_SUCCESS: Final = (
    Column("success", "", "success"),
    Column("with BeyondMimic's limits", "", "success_strict"),
    Column("with SONIC's limits", "", "success_sonic"),
    Column("completed", "", "completed"),
    Column("played", "% of what was to be played", "progress", ".1f", 100.0),
    Column("mean distance of all links", "mm at most", "max_link_error_mm", ".1f"),
    Column("measured", "", "links", words=_SPACES),
    Column("spoilt by", "ms", "spoilt_by_ms"),
)
_TERMINATIONS: Final = (
    Column("torso's height", "mm", "max_anchor_height_mm", ".1f"),
    Column("hand's or foot's height", "mm", "max_end_effector_height_mm", ".1f"),
    Column("gravity", "", "max_gravity_difference", ".3f"),
    Column("beyond SONIC's limits", "first", "sonic.link"),
    Column("at", "s", "sonic.at_s", ".2f"),
    Column("height", "mm", "sonic.height_mm", ".1f"),
    Column("rotation", "deg", "sonic.rotation_rad", ".1f", _DEG),
)
_MJLAB: Final = (
    Column("MPKPE", "mm", "mpkpe_mm", ".1f"),
    Column("R-MPKPE", "mm", "r_mpkpe_mm", ".1f"),
    Column("end effectors", "mm", "ee_pos_error_mm", ".1f"),
    Column("rotation", "deg", "ee_ori_error_rad", ".1f", _DEG),
    Column("joint velocity", "rad/s", "joint_vel_error_rad_s", ".3f"),
)
_OVERVIEW: Final = (
    Column("RMSE", "deg", "metrics.tracking.all_joints.rmse_rad", ".3f", _DEG),
    Column("worst", "deg", "metrics.tracking.all_joints.max_abs_rad", ".2f", _DEG),
    Column("worst joint", "by RMSE", "metrics.tracking.all_joints.worst_joint"),
    Column("delay", "ms", "metrics.tracking.all_joints.delay_s", ".1f", 1e3),
    Column("MPJPE", "mm, joints alone", "metrics.body.pelvis_frame.mpjpe_mm", ".2f"),
    Column("torque", "N·m RMS", "metrics.torque.rms_nm", ".2f"),
    Column("rate", "Hz", "metrics.timing.rate_hz", ".1f"),
    Column("skipped", "ticks", "metrics.timing.skipped_ticks"),
)
_EXCESSES: Final = (
    Column("what", "", "cause"),
    Column("of", "", "where"),
    Column("worst", "", "worst", ".4g"),
    Column("limit", "", "limit", ".4g"),
    Column("unit", "", "unit"),
    Column("at", "s", "time_s", ".2f"),
    Column("longest", "s", "longest_s", ".2f"),
    Column("cannot be followed", "", "forbids"),
)
_FEET: Final = (
    Column("contact", "% of frames", "contact_share", ".0f", 100.0),
    Column("height", "mm in contact", "height_mm", ".1f"),
    Column("penetration", "mm at most", "penetration_mm", ".1f"),
    Column("skating", "mm/s, mean", "skating_mm_s", ".1f"),
    Column("fastest", "mm/s", "skating_max_mm_s", ".1f"),
)
_PEAKS: Final = (
    Column("joint", "", "joint"),
    Column("torque", "N·m", "torque_nm", ".1f"),
    Column("limit", "N·m", "limit_nm"),
    Column("at", "s", "time_s", ".2f"),
    Column("beyond", "frames", "frames"),
)
_COLLISIONS: Final = (
    Column("in", "", "other"),
    Column("depth", "mm", "depth_mm", ".1f"),
    Column("at", "s", "time_s", ".2f"),
    Column("simulated", "", "simulated"),
)
_DELAYS_OF_STEPS: Final = {
    "delay_s": "from LowState to command",
    "state_age_s": "age of the state observed",
    "inference_s": "inference",
}
_PUNCTUALITY: Final = {
    "lateness_us": "lateness of writes",
    "interval_us": "interval between commands",
    "state_age_us": "age of the newest state at a command",
    "state_to_command_us": "from LowState to its command",
}


def tables(metrics: Mapping[str, Any], key: str, *, held: bool = False) -> dict[str, Table | None]:
    """The tables of a session's metrics, by name; None for an empty table.

    If the pelvis was `held`, values that depend on its own pose are omitted.
    """

    def table_of(head: str, columns: Sequence[Column], rows: Mapping[str, str]) -> Table | None:
        shown = [(name, path, _at(metrics, path)) for path, name in rows.items()]
        there = [(name, f"{key}.{path}", row) for name, path, row in shown if row is not None]
        return table(head, columns, there)

    def each(path: str) -> dict[str, str]:
        names = _at(metrics, path) or {}
        return {f"{path}.{name}": _plain(name) for name in names}

    limbs = {**each("tracking.limbs"), "tracking.all_joints": "all joints"}
    spaces = {f"body.{k}": v for k, v in _SPACES.items() if k == "pelvis_frame" or not held}
    pelvis = {} if held else {"body.pelvis": "pelvis"}
    ends = {} if held else {"body.terminations": "off by"}
    return {
        "success": table_of("", _SUCCESS, {"success": "motion"}),
        "terminations": table_of("at most", _TERMINATIONS, ends),
        "limbs": table_of("limb", _LIMBS, limbs),
        "joints": table_of("joint", _JOINTS, each("tracking.joints")),
        "links": table_of("links", _LINKS, spaces),
        "end_effectors": table_of("hand or foot", _END_EFFECTORS, each("body.end_effectors")),
        "mjlab": table_of("", _MJLAB, {} if held else {"body.mjlab": "as mjlab evaluates"}),
        "pelvis": table_of("", _PELVIS, pelvis),
        "torque": table_of("", _ALL_TORQUES, {"torque": "all joints"}),
        "torques": table_of("joint", _TORQUES, each("torque.joints")),
        "punctuality": table_of(
            "", _PERCENTILES, {f"timing.{k}": v for k, v in _PUNCTUALITY.items()}
        ),
        "topics": table_of("topic", _TOPICS, each("timing.topics")),
    }


def overview(sessions: Sequence[Mapping[str, Any]]) -> Table | None:
    """A table with a row for each of several sessions, given as JSON of the report."""
    rows = [(Path(one["path"]).name, f"sessions.{i}", one) for i, one in enumerate(sessions)]
    return table("session", _OVERVIEW, rows)


def physics_tables(
    physics: MotionPhysics, supports: Sequence[StreamSupport], key: str
) -> dict[str, Any]:
    """The tables of a motion's physics, and the number of colliding links.

    Excesses and torques are those for some of the supports.
    """
    values = physics.model_dump(mode="json")

    def each(path: str) -> list[tuple[str, str, Any]]:
        rows = enumerate(values[path])
        return [(short_name(row["link"]), f"{key}.{path}.{i}", row) for i, row in rows]

    # The same excess may apply to several supports; it is in the JSON of each.
    keys = {
        excess: f"{key}.verdicts.{one}.excesses.{i}"
        for one, verdict in physics.verdicts.items()
        for i, excess in enumerate(verdict.excesses)
    }
    against = [
        (of, keys[excess], excess.model_dump(mode="json"))
        for of, excess in reasons({one: physics.verdicts[one] for one in supports})
    ]
    peaks = [
        (one, f"{key}.torques.{one}.{i}", row)
        for one, rows in values["torques"].items()
        if one in supports
        for i, row in enumerate(rows[:_MOST_PEAKS])
    ]
    collisions = each("collisions")
    deepest = f": the {_MOST_PAIRS} deepest" if len(collisions) > _MOST_PAIRS else ""
    return {
        "excesses": table("support", _EXCESSES, against),
        "feet": table("foot", _FEET, each("feet")),
        "peaks": table("support", _PEAKS, peaks),
        "collisions": table("link", _COLLISIONS, collisions[:_MOST_PAIRS]),
        "collided": f"{counted(len(collisions), 'pair')} of colliding links{deepest}",
    }


def policy_tables(policy: Mapping[str, Any], key: str) -> dict[str, Table | None]:
    """The tables of a `PolicySteps` in JSON: delays, and the terms of the observation.

    After a fall, the terms that deviated most come first.
    """
    delays = [
        (name, f"{key}.{field}", policy[field])
        for field, name in _DELAYS_OF_STEPS.items()
        if policy[field]
    ]
    terms = sorted(policy["terms"].items(), key=lambda one: -(one[1]["deviation"] or 0.0))
    rows = [(name, f"{key}.terms.{name}", one) for name, one in terms]
    return {
        "delays": table("delay", _MILLISECONDS, delays),
        "terms": table("term", _TERMS, rows),
    }


def table(
    head: str, columns: Sequence[Column], rows: Iterable[tuple[str, str, Any]]
) -> Table | None:
    """A table without empty columns; None if all columns are empty."""
    rows = list(rows)
    columns = [c for c in columns if any(_at(row, c.key) not in (None, "") for _, _, row in rows)]
    if not columns:
        return None
    cells = [
        (name, [_cell(one, f"{path}.{one.key}", _at(row, one.key)) for one in columns])
        for name, path, row in rows
    ]
    return Table(head, columns, cells)


def _cell(column: Column, key: str, value: Any) -> Cell | None:
    if value is None:
        return None
    if isinstance(value, bool):
        text = "yes" if value else "no"
    elif isinstance(value, str):
        text = column.words[value] if column.words else _plain(value)
    else:
        text = format(value * column.scale, column.form)
        if not float(text):
            text = format(0.0, column.form)  # avoid "-0"
    return Cell(json.dumps(value), key, text)


def _plain(name: str) -> str:
    """A readable name of a joint, link or limb; topics are unchanged."""
    return name if name.startswith("/") else short_name(name)


def _at(values: Any, path: str) -> Any:
    """The value at a path of keys in nested dicts; None if it is missing."""
    for part in path.split("."):
        values = values.get(part) if isinstance(values, dict) else None
    return values
