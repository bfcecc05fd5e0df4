"""Convert a motion file into a session file, without a robot, a simulator or DDS."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream._version import __version__
from g1stream.errors import ConfigError, MotionError
from g1stream.files import check_not_input, check_suffix, complete_file
from g1stream.input_limits import LATEST_NS
from g1stream.motion.check import dropped_joints
from g1stream.motion.readers import load_motion
from g1stream.robot.model import G1
from g1stream.session.format import encode_string
from g1stream.session.records import MotionInfo
from g1stream.session.writer import SessionWriter, attach_motion
from g1stream.view.encoders import (
    IDENTITY_POSE,
    JointStatesTemplate,
    TransformsEncoder,
)
from g1stream.view.scene import encode_scene, meshes_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from g1stream.motion.motion import Motion
    from g1stream.types import Ints

__all__ = ["ConvertReport", "convert", "frame_timestamps", "parse_time"]

#: Poses in one chunk. A chunk (about 6 kB a pose) fits into the processor's cache, which makes
#: encoding several times faster, and is large enough to compress well.
_CHUNK: Final = 128
_TF, _JOINTS = "/tf", "/reference/joint_states"
_RESAMPLED_FIELDS: Final = ("position", "velocity", "acceleration")

_NS_PER_S: Final = 1_000_000_000
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=timezone.utc)
#: At most 40 digits, because Python refuses to convert thousands of them.
_WHOLE: Final = re.compile(r"[+-]?[0-9]{1,40}")
_ISO: Final = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9}))?(Z|[+-]\d\d:?[0-5]\d)?",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class ConvertReport:
    """Result of a conversion.

    Attributes:
        path: file that was written.
        size: its size, bytes.
        motion: name of the motion.
        frames: number of poses written.
        rate: poses per second.
        start_ns, end_ns: first and last time, ns since the epoch.
        counts: messages by topic.
        warnings: those of the motion as it was read, joints that the robot lacks, and meshes that
            were not found.
    """

    path: Path
    size: int
    motion: str
    frames: int
    rate: float
    start_ns: int
    end_ns: int
    counts: dict[str, int]
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The report as JSON values."""
        duration = (self.end_ns - self.start_ns) / 1e9
        return {**vars(self), "path": str(self.path), "duration_s": duration}


def convert(
    motion: Motion | str | Path,
    out: str | Path,
    *,
    robot: G1 | None = None,
    fps: float | None = None,
    base_time_ns: int = 0,
    frames: tuple[int | None, int | None] = (None, None),
    resample: float | None = None,
    floating_root: bool = True,
    flat: bool = False,
    only_tf: bool = False,
    meshes: bool = False,
    force: bool = False,
    on_progress: Callable[[float], None] = lambda _: None,
) -> ConvertReport:
    """Write a motion as a session file: transforms, joint states, scene and URDF of the robot.

    Log and publish time of every message are the base time + frame / fps, rounded to the nearest
    nanosecond. Nothing is written if it fails.

    Args:
        motion: a motion, a motion file, a session file, or the name of a bundled motion.
        out: the session file.
        robot: the robot whose joints the motion has; the 29-dof G1 if None.
        fps: frame rate of the motion file; the motion's own if None.
        base_time_ns: time of frame 0, ns since the epoch.
        frames: (first, stop) as in a slice; None means the motion's start or end.
        resample: rate at which to sample the spline through the frames, Hz; None writes the frames
            themselves.
        floating_root: False fixes the root link at the world's origin.
        flat: make every link a child of the world instead of its parent link.
        only_tf: write the transforms alone: no joint states, scene, URDF or attached motion.
        meshes: show the URDF's meshes, simplified, or the real G1's (extra `meshes`).
        force: replace an existing file.
        on_progress: called with the fraction done, 0 to 1.

    Raises:
        G1StreamError: the motion, the robot, an option or the file is not valid.
    """
    out = Path(out)
    check_suffix(out, "a session file; motion files end in .csv or .npz", ".mcap")
    robot = robot or G1.default()
    if isinstance(motion, str | Path):
        motion = load_motion(motion, fps=fps)
    elif fps is not None:
        motion = replace(motion, fps=fps)
    start, stop = _frame_range(motion, frames)
    first, last = frame_timestamps(base_time_ns, (start, stop - 1), motion.fps).tolist()
    transforms = TransformsEncoder(robot, flat=flat)
    fields = ("position",) if resample is None else _RESAMPLED_FIELDS
    joint_states = JointStatesTemplate(robot.joint_names, fields)
    check_not_input(out, motion.source, Path(robot.source))
    drawn = None if only_tf else meshes_of(robot, simplified=meshes)
    how = {
        "base_time_ns": base_time_ns,
        "frames": frames,
        "resample": None if resample is None else float(resample),
        "floating_root": floating_root,
        "flat": flat,
        "only_tf": only_tf,
        "meshes": meshes,
    }
    with complete_file(out, force=force) as temporary, SessionWriter(temporary) as writer:
        writer.add_metadata(_metadata(motion, robot, how))
        if not only_tf:
            writer.attach("robot.urdf", "application/xml", robot.urdf.encode(), first)
            attach_motion(writer, MotionInfo.from_motion(motion), first)
            writer.write("/scene", encode_scene(first, robot, drawn), first, first)
            writer.write("/robot_description", encode_string(robot.urdf), first, first)
        poses_of_motion = _poses(motion, base_time_ns, resample, start, stop)
        for times, joint_pos, root_pos, root_quat, *rates in poses_of_motion:
            root = (root_pos, root_quat) if floating_root else IDENTITY_POSE
            poses = transforms.encode(times, joint_pos, *root)
            writer.write_batch(_TF, poses, times, times)
            if not only_tf:
                joints = joint_states.encode(times, joint_pos, *rates)
                writer.write_batch(_JOINTS, joints, times, times)
            writer.flush()
            on_progress((int(times[-1]) - first) / max(1, last - first))
    warnings = motion.warnings
    if (dropped := dropped_joints(motion, robot)) and dropped.moved:
        warnings += (f"{motion.name}: {dropped}.",)
    if drawn and drawn.missing:
        warnings += (
            f"{robot.source}: meshes not found: {len(drawn.missing)}, such as "
            f"{drawn.missing[0]}; the scene has only their names.",
        )
    return ConvertReport(
        path=out,
        size=out.stat().st_size,
        motion=motion.name,
        frames=writer.counts[_TF],
        rate=resample or motion.fps,
        start_ns=first,
        end_ns=last,
        counts=writer.counts,
        warnings=warnings,
    )


def _frame_range(motion: Motion, frames: tuple[int | None, int | None]) -> tuple[int, int]:
    start = 0 if frames[0] is None else frames[0]
    stop = motion.n_frames if frames[1] is None else frames[1]
    if not 0 <= start < stop <= motion.n_frames:
        raise MotionError(
            f"The frames {start}:{stop} are out of range: {motion.name} has {motion.n_frames}.",
            f"Choose a range within 0:{motion.n_frames}, of one frame or more.",
        )
    return start, stop


def _poses(
    motion: Motion, base: int, rate: float | None, start: int, stop: int
) -> Iterator[tuple[Any, ...]]:
    """The poses to write, `_CHUNK` rows at a time: frames, or samples of the spline.

    Yields:
        times (T,) ns, joint_pos (T, 29), root_pos (T, 3), root_quat_wxyz (T, 4) and, if
        resampled, joint_vel and joint_acc (T, 29).
    """
    parts: Iterable[tuple[Any, ...]]
    if rate is None:
        times, rows = frame_timestamps(base, range(start, stop), motion.fps), slice(start, stop)
        pose = (motion.joint_pos[rows], motion.root_pos[rows], motion.root_quat_wxyz[rows])
        parts = [(times, *pose)]
    else:
        parts = (
            (
                frame_timestamps(base, numbers, rate),
                *(point.joint_pos, point.root_pos, point.root_quat_wxyz),
                *(point.joint_vel, point.joint_acc),
            )
            for numbers, point in motion.samples(rate, start, stop)
        )
    for part in parts:
        for first in range(0, len(part[0]), _CHUNK):
            yield tuple(array[first : first + _CHUNK] for array in part)


def _metadata(motion: Motion, robot: G1, how: dict[str, Any]) -> dict[str, Any]:
    """The motion and options of the conversion; equal for equal input on every machine."""
    return {
        "g1stream": __version__,
        "made_by": "g1stream convert",
        "motion": {
            "name": motion.name,
            "fps": motion.fps,
            "frames": motion.n_frames,
            "file": motion.source.name if motion.source else None,
            "sha256": motion.sha256,
            "operations": list(motion.operations),
        },
        "robot": robot.name,
        "conversion": how,
    }


def frame_timestamps(base_ns: int, frames: Iterable[int], fps: float) -> Ints:
    """Times of increasing frames, base + frame / fps, as (T,) int64 ns.

    They are rounded to the nearest nanosecond, halves up. The frame rate is interpreted as the
    decimal number that it prints as (29.97 is 2997/100). The division is exact, so rounding errors
    do not accumulate.
    """
    rate = Fraction(repr(float(fps)))
    numerator, denominator = 2 * _NS_PER_S * rate.denominator, 2 * rate.numerator
    times = [base_ns + (frame * numerator + rate.numerator) // denominator for frame in frames]
    if times and times[-1] >= LATEST_NS:
        raise ConfigError(
            "The motion would end after the year 2116, the last year of a session.",
            "Give an earlier base time.",
        )
    return np.array(times, dtype=np.int64)


def parse_time(text: str) -> int:
    """Parse a time as ns since the epoch, from whole nanoseconds or ISO 8601 with a time zone.

    For example `2026-03-01T12:00:00.123456789Z`, `2026-03-01 12:00+01:00`.
    """
    time = int(text) if _WHOLE.fullmatch(text) else _parse_iso(text)
    if not 0 <= time < LATEST_NS:
        raise ConfigError(
            f"The time {text} is {'before 1970' if time < 0 else 'after 2116'}.",
            "Give one between 0 and 2^62 - 1 ns since the epoch.",
        )
    return time


def _parse_iso(text: str) -> int:
    match = _ISO.fullmatch(text)
    if match is None:
        raise _not_a_time(text)
    date, clock, fraction, zone = match.groups()
    if zone is None:
        raise ConfigError(
            f"The time {text} has no time zone.",
            f"Add one: {text}Z for UTC, or an offset such as {text}+01:00.",
        )
    # Python 3.10 supports neither Z nor an offset without a colon, and no version nanoseconds.
    offset = "+00:00" if zone in "Zz" else f"{zone[:3]}:{zone[-2:]}"
    try:
        moment = datetime.fromisoformat(f"{date}T{clock}{offset}")
    except ValueError as error:
        raise _not_a_time(text) from error
    seconds = (moment - _EPOCH) // timedelta(seconds=1)
    return seconds * _NS_PER_S + int((fraction or "").ljust(9, "0"))


def _not_a_time(text: str) -> ConfigError:
    return ConfigError(
        f"{text!r} is not a time.",
        "Give nanoseconds since the epoch, or ISO 8601 such as 2026-03-01T12:00:00Z.",
    )
