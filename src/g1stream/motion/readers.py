"""Motion files -> `Motion`: the Foxglove CSV and the LAFAN1 CSV, told apart by what is in them.

Foxglove: a header and 37 columns, `Frame,X,Y,Z,QX,QY,QZ,QW,` and a joint each, in any order.
LAFAN1 as distributed for the G1: no header and 36 columns, position, quaternion and the 29 joints
in motor order. Both have metres, radians and quaternions xyzw; neither says its frame rate.
"""

from __future__ import annotations

import hashlib
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.errors import MotionError
from g1stream.motion.motion import Motion, check_fps
from g1stream.motion.table import Outline, Table, outline_table, read_table
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import wxyz_from_xyzw

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from g1stream.robot.model import G1

__all__ = [
    "BUNDLED_MOTIONS",
    "DEFAULT_FPS",
    "ROOT_COLUMNS",
    "MotionFile",
    "load_motion",
    "motion_of",
    "outline_file",
    "read_file",
]

#: Motions of our own making that come with the package, by the name `load_motion` knows them by.
BUNDLED_MOTIONS: Final = ("demo",)
#: Frames a second of LAFAN1, and so of both formats unless told.
DEFAULT_FPS: Final = 30.0

_FRAME: Final = "Frame"
_POSITION: Final = ("X", "Y", "Z")
_QUAT_XYZW: Final = ("QX", "QY", "QZ", "QW")
#: All columns but the joints'.
ROOT_COLUMNS: Final = (_FRAME, *_POSITION, *_QUAT_XYZW)
_HEADERLESS: Final = (*_POSITION, *_QUAT_XYZW, *JOINT_NAMES)
#: From unit norm. What is off by more is told; by more than the second, no rounding explains it.
_NORM_TOLERANCE: Final = 1e-3
_NORM_ROUNDING: Final = 0.1


class MotionFile(NamedTuple):
    """A motion file as it is, before anything is asked of it but to be a table of numbers.

    Attributes:
        path: where it is.
        sha256: of its bytes, in hex.
        table: its columns; a file without a header has LAFAN1's.
    """

    path: Path
    sha256: str
    table: Table

    @property
    def quat_xyzw(self) -> NDArray[np.float64]:
        """Orientation of the root (T, 4), as it stands in the file.

        Raises:
            KeyError: a column is not there.
        """
        return self.table[_QUAT_XYZW]


def outline_file(path_or_name: str | os.PathLike[str]) -> tuple[Path, Outline]:
    """Where a motion file is and what its first line shows, whatever is wrong in the others.

    Raises:
        MotionError: there is no such file, or it cannot be read, or is empty, or no text.
    """
    path = _find(path_or_name)
    return path, outline_table(path.name, _read(path), _HEADERLESS)


def read_file(path_or_name: str | os.PathLike[str]) -> MotionFile:
    """Read the table in a motion file, or in a bundled motion by its bare name.

    Raises:
        MotionError: there is no such file, or it is not a table of numbers; says where.
    """
    path = _find(path_or_name)
    content = _read(path)
    table = read_table(path.name, content, _HEADERLESS)
    return MotionFile(path, hashlib.sha256(content).hexdigest(), table)


def load_motion(
    path_or_name: str | os.PathLike[str], robot: G1 | None = None, *, fps: float | None = None
) -> Motion:
    """Read a motion file, or a bundled motion by its bare name (`demo`).

    Args:
        path_or_name: a bundled motion's name, or the path of a CSV of 37 columns with a header
            (Foxglove) or of 36 without (LAFAN1 for the G1 as distributed).
        robot: whose joints the file must have; the 29-dof G1 if None.
        fps: frames a second of the file, `DEFAULT_FPS` if None.

    Returns:
        The motion with its joints in the robot's order (motor order), whatever the file's order.
        Quaternions come out unit; those that were off by more than 1e-3 earn a warning, which
        names the furthest off.

    Raises:
        MotionError: there is no such file, or it is not one of these formats, or something in it
            cannot be right; says where (file, line, column).
    """
    check_fps(DEFAULT_FPS if fps is None else fps, _find(path_or_name).stem)
    return motion_of(read_file(path_or_name), robot, fps=fps)


def motion_of(file: MotionFile, robot: G1 | None = None, *, fps: float | None = None) -> Motion:
    """What `load_motion` makes of a file that was read."""
    table = file.table
    joint_names = JOINT_NAMES if robot is None else robot.joint_names
    _check_columns(table, joint_names)
    if _FRAME in table.columns:
        _check_frame_numbers(table)
    if len(table.values) < 2:
        raise MotionError(
            f"{table.name} has only one frame.",
            "Give it two frames or more: with one there is nothing to move between.",
        )
    return Motion(
        name=file.path.stem,
        fps=DEFAULT_FPS if fps is None else fps,
        joint_names=joint_names,
        joint_pos=table[joint_names],
        root_pos=table[_POSITION],
        root_quat_wxyz=wxyz_from_xyzw(file.quat_xyzw),
        source=file.path,
        sha256=file.sha256,
        warnings=_check_norms(table, file.quat_xyzw),
    )


def _find(path_or_name: str | os.PathLike[str]) -> Path:
    if path_or_name in BUNDLED_MOTIONS:
        return Path(str(resources.files("g1stream.motion") / f"{path_or_name}.csv"))
    return Path(path_or_name)


def _read(path: Path) -> bytes:
    try:
        # Files are read more than once, and a pipe gives what is in it only once.
        if not (path.is_file() or path.is_dir()) and path.exists():
            raise MotionError(f"{path} is not a file.", "Save what it gives to a file; give that.")
        return path.read_bytes()
    except FileNotFoundError:
        bundled = ", ".join(BUNDLED_MOTIONS)
        cause = f"There is no motion file {path}."
        remedy = (
            "Give the path of a CSV file or of a session file, or the name of a bundled motion: "
            f"{bundled}."
        )
    except IsADirectoryError:
        cause = f"{path} is a directory."
        remedy = "Give the path of one motion file in it."
    except OSError as error:
        cause = f"{path} cannot be read: {error.strerror}."
        remedy = "Check the path and its permissions."
    raise MotionError(cause, remedy)


def _check_columns(table: Table, joint_names: tuple[str, ...]) -> None:
    """Every column is known and there is one for each thing needed."""
    header = table.header_line
    wanted = ROOT_COLUMNS
    lacks = [name for name in wanted if name not in table.columns]
    if header is not None and lacks:
        raise MotionError(
            f"{table.name}, line {header}: the header has no column {_listed(lacks)}.",
            f"Name the columns {','.join(wanted)} and the {len(joint_names)} joints, in any order; "
            "or leave out the header and use the 36 columns of LAFAN1.",
        )
    unknown = [name for name in table.columns if name not in wanted and name not in joint_names]
    missing = [name for name in joint_names if name not in table.columns]
    if unknown or missing:
        faults = []
        if unknown:
            faults.append(f"has joints that the robot lacks: {_listed(unknown)}")
        if missing:
            faults.append(f"lacks joints that the robot has: {_listed(missing)}")
        where = table.name if header is None else f"{table.name}, line {header}: the header"
        raise MotionError(
            f"{where} {' and '.join(faults)}.",
            "Name the columns as the robot's URDF names its joints, one for each of "
            f"its {len(joint_names)} motors.",
        )


def _check_frame_numbers(table: Table) -> None:
    """Frame numbers are whole and rise by one. The first may be any, as in a clip cut out."""
    numbers = table[(_FRAME,)][:, 0]
    broken = np.flatnonzero(numbers != np.rint(numbers))
    if broken.size:
        where = table.where(int(broken[0]), _FRAME)
        raise MotionError(
            f"{where}: the frame number {numbers[broken[0]]:g} is not whole.",
            "Number the frames 0, 1, 2 and so on.",
        )
    jumps = np.flatnonzero(np.diff(numbers) != 1)
    if not jumps.size:
        return
    row = int(jumps[0]) + 1
    before, number = int(numbers[row - 1]), int(numbers[row])
    if number in numbers[:row]:
        fault = f"frame {number} is there twice"
    elif number == before + 2:
        fault = f"frame {before + 1} is missing"
    elif number > before:
        fault = f"frames {before + 1} to {number - 1} are missing"
    else:
        fault = f"frame {number} comes after frame {before}"
    raise MotionError(
        f"{table.where(row, _FRAME)}: {fault}.",
        "Frames must be numbered without gap, one a line, in order.",
    )


def _check_norms(table: Table, quat: NDArray[np.float64]) -> tuple[str, ...]:
    """Warn of quaternions (T, 4) that are not unit; raise for one that is zero."""
    norms = np.linalg.norm(quat, axis=1)
    off = np.abs(norms - 1.0)
    zero = np.flatnonzero(norms == 0.0)
    if zero.size:
        raise MotionError(
            f"{table.where(int(zero[0]), 'QX')}: the quaternion QX,QY,QZ,QW is zero.",
            "Give every frame an orientation; none at all is 0,0,0,1.",
        )
    n_bad, worst = int((off > _NORM_TOLERANCE).sum()), int(np.argmax(off))
    if not n_bad:
        return ()
    doubt = "; that is no rounding error: see what is wrong there"
    return (
        f"{table.name}: {n_bad} of {len(quat)} quaternions had to be normalised. "
        f"Furthest off is frame {worst}, line {table.line(worst)}, with the norm {norms[worst]:.4g}"
        f"{doubt if off[worst] > _NORM_ROUNDING else ''}.",
    )


def _listed(names: list[str]) -> str:
    return ", ".join(names)
