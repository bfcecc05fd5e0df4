"""What is in a motion file, what of it a robot takes, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from g1stream.errors import MotionError
from g1stream.motion.check import check_motion
from g1stream.motion.readers import ROOT_COLUMNS, load_motion, read_file

if TYPE_CHECKING:
    import os

    from g1stream.motion.check import MotionReport
    from g1stream.motion.readers import MotionFile
    from g1stream.robot.model import G1

__all__ = ["FileReport", "MappedColumn", "NormRange", "check_file"]


class MappedColumn(NamedTuple):
    """A column of the file, counted from 1, and the joint of the robot that it is."""

    column: int
    joint: str


class NormRange(NamedTuple):
    """The least and the greatest norm of the root's quaternions as the file has them."""

    lowest: float
    highest: float


@dataclass(frozen=True)
class FileReport:
    """What `check_file` found. Where the file is no table, only `path` and `fault` say anything.

    Attributes:
        path: of the file.
        n_rows: lines of numbers.
        n_columns: columns.
        has_header: whether they are named in the file; else they are taken to be LAFAN1's.
        mapped: the joint columns that the robot has a joint for, in the order of the file.
        not_in_robot: joints of the file that the robot lacks.
        not_in_file: joints of the robot that the file lacks.
        quat_norms: None where the file has no quaternions.
        motion: measured against the robot; None where the file is not a motion of this robot.
        fault: why it is not, in a sentence; empty where it is.
    """

    path: Path
    n_rows: int = 0
    n_columns: int = 0
    has_header: bool = False
    mapped: tuple[MappedColumn, ...] = ()
    not_in_robot: tuple[str, ...] = ()
    not_in_file: tuple[str, ...] = ()
    quat_norms: NormRange | None = None
    motion: MotionReport | None = None
    fault: str = ""

    @property
    def all_well(self) -> bool:
        """Whether the file is a motion of the robot, within its limits and with nothing to mend."""
        return bool(self.motion and self.motion.within_limits and not self.motion.warnings)


def check_file(
    path_or_name: str | os.PathLike[str], robot: G1, *, fps: float | None = None
) -> FileReport:
    """Look at a motion file, or at a bundled motion by its bare name.

    Args:
        path_or_name: as `load_motion` takes it.
        robot: whose joints the file should have.
        fps: frames a second of the file; as `load_motion` has it if None.

    Raises:
        MotionError: there is no such file, or the frame rate is none.
    """
    try:
        file = read_file(path_or_name)
    except MotionError as error:
        if not Path(path_or_name).is_file():
            raise
        return FileReport(Path(path_or_name), fault=error.cause)
    motion, fault = None, ""
    try:
        motion = check_motion(load_motion(path_or_name, robot, fps=fps), robot)
    except MotionError as error:
        fault = error.cause
    columns = file.table.columns
    joints = [name for name in columns if name not in ROOT_COLUMNS]
    return FileReport(
        path=file.path,
        n_rows=len(file.table.values),
        n_columns=len(columns),
        has_header=file.table.header_line is not None,
        mapped=tuple(
            MappedColumn(columns.index(name) + 1, name)
            for name in joints
            if name in robot.joint_names
        ),
        not_in_robot=tuple(name for name in joints if name not in robot.joint_names),
        not_in_file=tuple(name for name in robot.joint_names if name not in joints),
        quat_norms=_norms(file),
        motion=motion,
        fault=fault,
    )


def _norms(file: MotionFile) -> NormRange | None:
    try:
        norms = np.linalg.norm(file.quat_xyzw, axis=1)
    except KeyError:
        return None
    return NormRange(float(norms.min()), float(norms.max()))
