"""Recordings of other programs as sessions: bags, joint state logs, and CSV logs.

Samples of a bag are used as they are. Joint states and CSV rows become samples of `/lowstate`, and
of `/lowcmd` if the log has targets. Values that the log lacks are 0, and gains are nan.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.dds.messages import LOWCMD, LOWSTATE, SPORTMODESTATE, encode_samples
from g1stream.errors import RecordingError
from g1stream.extras.attach.recorded_motion import open_recorded
from g1stream.files import is_session, read_file
from g1stream.input_limits import LATEST_NS, UNPACKED
from g1stream.motion.readers import MotionFile
from g1stream.optional import extension
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.session.format import CHANNEL_OF
from g1stream.session.recording import has_essentials
from g1stream.session.source import MemorySource, SessionFiles, files_of
from g1stream.text import counted, listed
from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from g1stream.dds.messages import Topic
    from g1stream.extras.attach.recorded_motion import RecordedMotion
    from g1stream.session.source import SessionSource

__all__ = ["open_log"]

#: Start time of a log whose times are not since the epoch: 2000-01-01 00:00 UTC, ns.
_EPOCH: Final = 946_684_800_000_000_000
#: Lowest time since the epoch in each unit (about 2001), and its factor to ns.
_SINCE_EPOCH: Final = ((1e18, 1.0), (1e15, 1e3), (1e12, 1e6), (1e9, 1e9))
_LEAST_NS: Final = 1e18
#: Longest usual interval in each unit, for logs whose times are not since the epoch.
_INTERVALS: Final = ((0.2, 1e9), (2e2, 1e6), (2e5, 1e3), (np.inf, 1.0))
_UNITS: Final = {"s": 1e9, "sec": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
_TIME_WORDS: Final = {"t", "time", "timestamp", "stamp"}
#: Number of columns without a meaning that are named.
_NAMED: Final = 6
#: Words in column names, by quantity.
_COMMAND: Final = {
    *("cmd", "lowcmd", "command", "target", "targets", "des", "desired", "ref", "reference"),
    *("goal", "setpoint"),
}
_VELOCITY: Final = {"dq", "qd", "vel", "velocity", "qvel"}
_TORQUE: Final = {"tau", "torque", "effort"}
_POSITION: Final = {"q", "pos", "position", "angle", "qpos"}
#: Words in column names without meaning for the quantity.
_NEUTRAL: Final = {
    *("", "joint", "joints", "motor", "state", "states", "lowstate", "body", "dof", "rt"),
    *("measured", "actual", "est", "estimated"),
}
_AXES: Final = {
    "quat": re.compile(r"(?:(?:base|imu|root|pelvis)_)?(?:q|quat|quaternion|rot)_?([wxyz])"),
    "gyro": re.compile(
        r"(?:(?:base|imu|root|pelvis)_)?(?:w|gyro|gyroscope|ang_vel|omega)_?([xyz])"
    ),
    "pos": re.compile(r"(?:base|root|pelvis)_(?:pos_|position_|p)?([xyz])"),
}
_JOINTS: Final = sorted(
    ((name.removesuffix("_joint"), i) for i, name in enumerate(JOINT_NAMES)),
    key=lambda one: -len(one[0]),
)


def open_log(path: Path) -> SessionSource:
    """Open a recording of another program.

    Args:
        path: a bag of ROS 2, an MCAP with joint states, or a CSV log.

    Raises:
        ConfigError: the extra that reads it is not installed.
        RecordingError: it is none of these, or damaged.
    """
    if path.suffix.lower() == ".csv":
        return _csv_log(path)
    in_mcap = is_session(files_of(path)[0])
    source: SessionSource = SessionFiles(path) if in_mcap else extension("read_log")(path)
    if has_essentials(source.topics):
        return source
    recorded = open_recorded(MotionFile(path))
    return _joint_log(path, recorded) if recorded.has_joints else source


def _joint_log(path: Path, recorded: RecordedMotion) -> MemorySource:
    """Joint states and pelvis transforms of a log as samples of a robot."""
    poses = recorded.poses()
    log = MemorySource(str(path))
    log.paths = files_of(path)
    values = {"q": poses.q}
    if poses.pelvis_known:
        values |= {"quat": poses.root_quat_wxyz, "pos": poses.root_pos}
    log.unread, log.complete = recorded.unread, not recorded.unread
    used = recorded.evidence.used
    told = {"made of": used["file"], "joint order": used["joint order"]}
    if poses.warnings:
        told["warnings"] = " ".join(poses.warnings)
    _write(log, poses.times, values, told)
    return log


class _Column(NamedTuple):
    """The meaning of a log's column: a quantity, and the index of its joint or axis."""

    quantity: str
    number: int


def _csv_log(path: Path) -> MemorySource:
    """The rows of a CSV file as samples of a robot."""
    log = MemorySource(str(path))
    log.paths = [path]
    names, table = _read_table(path)
    times, timed, clock = _times(names, table, path)
    columns: dict[_Column, Floats] = {}
    for name, values in zip(names, table.T, strict=True):
        if column := _column(name):
            columns.setdefault(column, values)
    joints = {one.number for one in columns if one.quantity == "q"}
    if not joints:
        raise RecordingError(
            f"{path} has no column with a joint position.",
            f"Name columns by quantity and joint, such as q.{JOINT_NAMES[3]}.",
        )
    values = {}
    for quantity, size in _SIZES.items():
        found = {one.number: columns[one] for one in columns if one.quantity == quantity}
        if found and (size == N_JOINTS or len(found) == size):
            values[quantity] = np.zeros((len(times), size))
            for number, samples in found.items():
                values[quantity][:, number] = samples
    missing = [name for i, name in enumerate(JOINT_NAMES) if i not in joints]
    told = {"time": clock, "made of": f"CSV, {', '.join(values)} in {counted(len(times), 'row')}"}
    known = [name for name in names if (one := _column(name)) and one.quantity in values]
    if unused := [name for name in names if name not in known and name != timed]:
        told["not used"] = listed(unused, _NAMED)
    _write(log, times, values, told, missing)
    return log


#: Number of values of each quantity: joints, the attitude wxyz, and vectors.
_SIZES: Final = {
    "q": N_JOINTS,
    "dq": N_JOINTS,
    "tau": N_JOINTS,
    "command": N_JOINTS,
    "quat": 4,
    "gyro": 3,
    "pos": 3,
}


def _write(
    log: MemorySource,
    times: Ints,
    values: Mapping[str, Floats],
    told: Mapping[str, str],
    missing: Sequence[str] = (),
) -> None:
    """Write samples (N, ...) by quantity at times (N,) ns, and how the log was interpreted."""
    state = {
        "motor_state.q": values["q"],
        "motor_state.dq": values.get("dq"),
        "motor_state.tau_est": values.get("tau"),
        "imu_state.quaternion": values.get("quat"),
        "imu_state.gyroscope": values.get("gyro"),
    }
    samples: dict[Topic, dict[str, Floats | None]] = {LOWSTATE: state}
    if "command" in values:
        gains = np.full((len(times), N_JOINTS), np.nan)
        samples[LOWCMD] = {
            "motor_cmd.q": values["command"],
            "motor_cmd.kp": gains,
            "motor_cmd.kd": gains,
        }
    if "pos" in values:
        samples[SPORTMODESTATE] = {"position": values["pos"]}
    for topic, fields in samples.items():
        known = {name: one for name, one in fields.items() if one is not None}
        data = encode_samples(topic, known, len(times))
        log.write_batch(CHANNEL_OF[topic.name], data, times, times)
    log.add_metadata({"log": told, **({"absent": missing} if missing else {})})


def _read_table(file: Path) -> tuple[list[str], Floats]:
    """The column names, and the rows (N, C)."""
    try:
        text = read_file(file, UNPACKED).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise RecordingError(f"{file} is not text.", "Give a CSV file in UTF-8.") from None
    except OSError as error:
        raise RecordingError(f"{file} cannot be read: {error.strerror}.", "Check it.") from error
    header, _, rows = text.partition("\n")
    names = [name.strip().strip("\"'") for name in header.split(",")]
    if not rows.strip():
        raise RecordingError(f"{file} has no rows.", "Give a CSV log with a header line.")
    try:
        table = np.loadtxt(rows.splitlines(), delimiter=",", ndmin=2)
    except ValueError as error:
        raise RecordingError(
            f"{file} is not a table of numbers: {error}.",
            "Give a CSV log with a header line and a number in each cell.",
        ) from error
    if len(table) < 2 or table.shape[1] != len(names):
        raise RecordingError(
            f"{file} has {counted(len(table), 'row')} of {table.shape[1]} values, but "
            f"{counted(len(names), 'column name')}.",
            "Give a CSV log with a header line and a value for each name in each row.",
        )
    return names, table


def _times(names: Sequence[str], table: Floats, file: Path) -> tuple[Ints, str, str]:
    """Times (N,) of the rows, ns since the epoch, their column, and how they were determined."""
    for name, values in zip(names, table.T, strict=True):
        words = _words(name)
        if not _TIME_WORDS & {*words} or not (np.diff(values) > 0.0).all():  # False for nan
            continue
        factor = next((_UNITS[word] for word in reversed(words) if word in _UNITS), None)
        assumed = "" if factor else ", unit assumed by its size"
        if factor is None:
            usual = float(np.median(np.diff(values)))
            by_size = (one for least, one in _SINCE_EPOCH if values[0] >= least)
            by_step = (one for most, one in _INTERVALS if usual <= most)
            factor = next(by_size, None) or next(by_step)
        if not abs(values[0] * factor) + (values[-1] - values[0]) * factor < LATEST_NS:
            continue
        since_epoch = values[0] * factor >= _LEAST_NS
        assumed += "" if since_epoch else ", counted from 2000-01-01 UTC"
        start = round(values[0] * factor) if since_epoch else _EPOCH
        times = start + np.round((values - values[0]) * factor).astype(np.int64)
        if (np.diff(times) > 0).all():
            return times, name, f"column {name}, in units of {factor:g} ns{assumed}"
    raise RecordingError(
        f"{file} has no column of increasing times.",
        "Name a column time_s, time_ms or timestamp_ns. For a motion use `g1stream motion`.",
    )


def _column(name: str) -> _Column | None:
    """The meaning of a column by its name, if it names a joint, a motor or an axis."""
    words = _words(name)
    text = "_".join(words)
    for quantity, pattern in _AXES.items():
        if found := pattern.fullmatch(text):
            axes = "wxyz" if quantity == "quat" else "xyz"
            return _Column(quantity, axes.index(found[1]))
    joint = next(((joint, i) for joint, i in _JOINTS if joint in text), None)
    numbers = [word for word in words if word.isdigit()]
    if joint is None and "motor" in words and len(numbers) == 1 and int(numbers[0]) < N_JOINTS:
        joint = numbers[0], int(numbers[0])  # motor_state[3].q of a LowState
    if joint is None:
        return None
    about = {*text.replace(joint[0], "").split("_")} - _NEUTRAL
    unknown = about - _COMMAND - _VELOCITY - _TORQUE - _POSITION
    command, velocity, torque = (bool(about & one) for one in (_COMMAND, _VELOCITY, _TORQUE))
    if unknown or (command and (velocity or torque)) or (velocity and torque):
        return None
    quantity = "command" if command else "dq" if velocity else "tau" if torque else "q"
    return _Column(quantity, joint[1])


def _words(name: str) -> list[str]:
    return re.findall(r"[a-z]+|[0-9]+", name.lower())
