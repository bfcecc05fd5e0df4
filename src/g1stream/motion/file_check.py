"""What is in a motion file, what of it a robot takes, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from g1stream.errors import MotionError
from g1stream.motion.check import check_motion
from g1stream.motion.motion import check_fps
from g1stream.motion.readers import (
    DEFAULT_FPS,
    ROOT_COLUMNS,
    motion_of,
    outline_file,
    read_file,
)

if TYPE_CHECKING:
    import os

    from g1stream.motion.check import MotionReport
    from g1stream.motion.motion import Motion
    from g1stream.motion.readers import MotionFile
    from g1stream.robot.model import G1

__all__ = ["FileReport", "MappedColumn", "NormRange", "check_file", "check_session"]


@dataclass(frozen=True)
class MappedColumn:
    """A column of the file, counted from 1, and the joint of the robot that it is."""

    column: int
    joint: str


@dataclass(frozen=True)
class NormRange:
    """The least and the greatest norm of the root's quaternions as the file has them."""

    lowest: float
    highest: float


@dataclass(frozen=True)
class FileReport:
    """What a look at a motion file or a session file found.

    Attributes:
        path: of the file.
        kind: a table of numbers, or a session, of which the rest tells only `motion` and `fault`.
        n_rows: lines below the header, or all lines where there is none.
        n_columns: columns of the first line.
        has_header: whether they are named in the file; else they are taken to be LAFAN1's, if there
            are as many.
        mapped: the joint columns that the robot has a joint for, in the order of the file.
        not_in_robot: joints of the file that the robot lacks.
        not_in_file: joints of the robot that the file lacks.
        quat_norms: None where the file has no quaternions, or something that is not a number.
        motion: measured against the robot; None where the file is not a motion of this robot.
        fault: why it is not, in a sentence; empty where it is.
        remedy: what to do about the fault, in a sentence.
    """

    path: Path
    kind: Literal["table", "session"] = "table"
    n_rows: int = 0
    n_columns: int = 0
    has_header: bool = False
    mapped: tuple[MappedColumn, ...] = ()
    not_in_robot: tuple[str, ...] = ()
    not_in_file: tuple[str, ...] = ()
    quat_norms: NormRange | None = None
    motion: MotionReport | None = None
    fault: str = ""
    remedy: str = ""

    @property
    def all_well(self) -> bool:
        """Whether this is a motion of the robot, within its limits. A warning is no fault."""
        return bool(self.motion and self.motion.within_limits)


def check_file(
    path_or_name: str | os.PathLike[str], robot: G1, *, fps: float | None = None
) -> FileReport:
    """Look at a motion file, or at a bundled motion by its bare name.

    Args:
        path_or_name: as `load_motion` takes it.
        robot: whose joints the file should have.
        fps: frames a second of the file; as `load_motion` has it if None.

    Raises:
        MotionError: there is no table to look at: no such file, one that cannot be read, is empty
            or no text; or the frame rate is none. What is wrong within a table is a finding.
    """
    path, outline = outline_file(path_or_name)
    check_fps(DEFAULT_FPS if fps is None else fps, path.stem)
    file, motion, fault = None, None, None
    try:
        file = read_file(path_or_name)
        motion = check_motion(motion_of(file, robot, fps=fps), robot)
    except MotionError as error:
        fault = error
    columns = enumerate(outline.columns, start=1)
    joints = {name: number for number, name in columns if name and name not in ROOT_COLUMNS}
    return FileReport(
        path=path,
        n_rows=outline.n_rows,
        n_columns=outline.n_columns,
        has_header=outline.header_line is not None,
        mapped=tuple(
            MappedColumn(number, name)
            for name, number in joints.items()
            if name in robot.joint_names
        ),
        not_in_robot=tuple(name for name in joints if name not in robot.joint_names),
        not_in_file=tuple(
            name for name in robot.joint_names if outline.columns and name not in joints
        ),
        quat_norms=_norms(file) if file else None,
        motion=motion,
        fault=fault.cause if fault else "",
        remedy=fault.remedy if fault else "",
    )


def check_session(path: str | os.PathLike[str], motion: Motion, robot: G1) -> FileReport:
    """Look at the motion that was read from a session file."""
    report = FileReport(Path(path), kind="session")
    try:
        return replace(report, motion=check_motion(motion, robot))
    except MotionError as error:
        return replace(report, fault=error.cause, remedy=error.remedy)


def _norms(file: MotionFile) -> NormRange | None:
    try:
        norms = np.linalg.norm(file.quat_xyzw, axis=1)
    except KeyError:
        return None
    return NormRange(float(norms.min()), float(norms.max()))
