"""Motion files in CSV: a row of root pose and joint angles per frame, in metres and radians.

There are two layouts, distinguished by the first line:

- Foxglove: a header and 37 columns, `Frame,X,Y,Z,QX,QY,QZ,QW` and the 29 joints, in any order, also
  under other names, such as `root_pos_x`, `quat_w` and `left_knee`, and without the frame number;
- LAFAN1 as distributed for the G1: no header and 36 columns, position, quaternion and the joints in
  motor order.

Quaternions are in xyzw order. Neither layout has a frame rate.

numpy parses the numbers. It says little about what it refuses, so that a file with a fault is then
searched cell by cell for the first one.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.input_limits import NUMBER
from g1stream.motion.arrays import names_in_order
from g1stream.motion.motion import (
    DEFAULT_FPS,
    ROOT_COLUMNS,
    SMALLEST_QUAT,
    Motion,
    norm_warnings,
)
from g1stream.motion.readers import Evidence
from g1stream.robot.joints import JOINT_NAMES
from g1stream.robot.rotations import wxyz_from_xyzw
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.motion.readers import MotionFile
    from g1stream.types import Floats

__all__ = ["CsvFile"]

_FRAME: Final = ROOT_COLUMNS[0]
_POSITION: Final = ROOT_COLUMNS[1:4]
_QUAT_XYZW: Final = ROOT_COLUMNS[4:]
#: Names that other tools give to the columns of the root.
_OTHER_NAMES: Final = {
    prefix + axis.lower()[-1]: axis
    for axes, prefixes in (
        (_POSITION, ("", "pos_", "root_", "root_pos_", "base_", "base_pos_")),
        (_QUAT_XYZW, ("q", "quat_", "rot_", "root_q", "root_quat_", "root_rot_", "base_quat_")),
    )
    for axis in axes
    for prefix in prefixes
} | {"frame": _FRAME}
_LAFAN1: Final = (*_POSITION, *_QUAT_XYZW, *JOINT_NAMES)


class CsvFile:
    """A CSV motion file: its layout, and on request its numbers.

    Args:
        file: UTF-8. A byte order mark, any line ends, spaces around cells and blank lines at the
            end are accepted.

    Raises:
        MotionError: it is empty or not text. Anything else wrong in it is an error only when
            `values` or `motion` is asked for.

    Attributes:
        has_header: whether the first line names the columns.
        columns: their names in the order of the file; those of LAFAN1 where 36 columns have no
            header, none where the names are unknown.
        n_columns: values in the first line.
        n_rows: lines below the header.
    """

    def __init__(self, file: MotionFile) -> None:
        self._file = file
        self._text = self._decode(file.content)
        first = [cell.strip() for cell in self._text.split("\n", 1)[0].split(",")]
        self.n_columns = len(first)
        self.has_header = not any(map(_is_number, first))
        self.columns: tuple[str, ...] = ()
        if not self.has_header and self.n_columns == len(_LAFAN1):
            self.columns = (*_LAFAN1[:7], *names_in_order(file.joint_order or "motor"))
        elif self.has_header and self.n_columns > 1:
            self.columns = tuple(map(_canonical_column, first))
        self.n_rows = self._text.count("\n") + 1 - self.has_header

    @property
    def evidence(self) -> Evidence:
        """What the table has, whether or not it is a motion."""
        named = "named by a header" if self.has_header else "no header"
        if self.columns and not self.has_header:
            named += ", columns as in LAFAN1"
        size = f"{counted(self.n_rows, 'row')}, {counted(self.n_columns, 'column')}, {named}"
        n_joints = len(set(JOINT_NAMES).intersection(self.columns))
        used = {"file": f"CSV, {size}; {counted(n_joints, 'joint')} found"}
        assumed = {}
        if self._file.fps is None:
            assumed["frame rate"] = f"{DEFAULT_FPS:g} fps"
        if self.columns and not self.has_header and self._file.joint_order is None:
            assumed["joint order"] = "motor"
        norms = None
        with suppress(MotionError):  # a fault that `motion` raises
            if set(_QUAT_XYZW) <= set(self.columns):
                length = np.linalg.norm(self._take(_QUAT_XYZW), axis=1)
                norms = float(length.min()), float(length.max())
        missing = tuple(self._missing if self.columns else ())
        return Evidence(used, assumed, tuple(self._unknown), missing, norms)

    @cached_property
    def values(self) -> Floats:
        """The numbers (n_rows, n_columns), all finite.

        Raises:
            MotionError: it is not a table of numbers in named columns; names line and column.
        """
        self._check_header()
        if not self.n_rows:
            raise self._error("there is a header but no frame", "Give it a line per frame.")
        try:
            lines = self._text.split("\n")[self.has_header :]
            values = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)
        except ValueError:
            raise self._first_fault() from None
        shape = (self.n_rows, self.n_columns)
        if values.shape != shape or not (np.abs(values) <= NUMBER).all():
            raise self._first_fault()
        return values

    def motion(self) -> Motion:
        """The motion in the file, its joints in motor order.

        Raises:
            MotionError: a column or a value is missing, unknown or wrong; names line and column.
        """
        self._check_header()
        self._check_columns()
        self._check_frame_numbers()
        quat = self._take(_QUAT_XYZW)
        return Motion(
            name=self._file.path.stem,
            fps=DEFAULT_FPS if self._file.fps is None else self._file.fps,
            joint_pos=self._take(JOINT_NAMES),
            root_pos=self._take(_POSITION),
            root_quat_wxyz=wxyz_from_xyzw(quat),
            source=self._file.path,
            sha256=self._file.sha256,
            warnings=self._check_norms(np.linalg.norm(quat, axis=1)),
        )

    def _take(self, columns: Sequence[str]) -> Floats:
        return self.values.take([self.columns.index(name) for name in columns], axis=1)

    @property
    def _missing(self) -> list[str]:
        """Columns of the layout that the file lacks."""
        wanted = (*ROOT_COLUMNS, *JOINT_NAMES) if self.has_header else _LAFAN1
        return [name for name in wanted if name not in (*self.columns, _FRAME)]

    @property
    def _unknown(self) -> list[str]:
        """Columns of the file that neither belong to the layout nor are joints."""
        known = (*ROOT_COLUMNS, *JOINT_NAMES)
        return [name for name in self.columns if name and name not in known]

    def _error(
        self, cause: str, remedy: str, *, line: int | None = None, column: int | None = None
    ) -> MotionError:
        """The error at a line, counted from 1, and a column, counted from 0."""
        where = self._file.path.name
        if line is not None:
            where += f", line {line}"
        if column is not None:
            where += f", column {column + 1}"
            where += f" ({self.columns[column]})" if self.columns[column] else ""
        return MotionError(f"{where}: {cause}.", remedy)

    def _line(self, row: int) -> int:
        return row + 1 + self.has_header

    def _decode(self, content: bytes) -> str:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = content.count(b"\n", 0, error.start) + 1
            raise self._error(
                f"byte {error.start} is not UTF-8 text",
                "Give a CSV file saved as UTF-8, an NPZ, a pickle of arrays, or a session file.",
                line=line,
            ) from None
        if "\0" in text:
            raise self._error(
                f"byte {text.index(chr(0))} of this binary file is zero",
                "Give a CSV or NPZ file, a pickle of arrays, or a session file.",
            )
        text = text.replace("\r\n", "\n").replace("\r", "\n").rstrip()
        if not text:
            raise self._error(
                "the file is empty", "Give a CSV file with a line per frame, or a session file."
            )
        return text

    def _check_header(self) -> None:
        if not self.columns:
            raise self._error(
                f"it is no motion: {counted(self.n_columns, 'column')}, and a motion has "
                f"{len(_LAFAN1)}, or a header that names them",
                "Separate values with commas, and put a header first or use the "
                f"{len(_LAFAN1)} columns of LAFAN1: {','.join(_LAFAN1[:8])} and the other joints "
                "in motor order.",
                line=1,
            )
        for column, name in enumerate(self.columns):
            if not name or name in self.columns[:column]:
                raise self._error(
                    "another column has the same name" if name else "the header has an empty name",
                    "Give each column a name of its own, and end no line with a comma.",
                    line=1,
                    column=column,
                )

    def _first_fault(self) -> MotionError:
        """The error about the first cell or line that is not what it should be."""
        lines = self._text.split("\n")
        for number, line in enumerate(lines[self.has_header :], start=1 + self.has_header):
            cells = line.split(",")
            if not line.strip():
                return self._error("the line is blank", "Remove it.", line=number)
            if len(cells) != self.n_columns:
                return self._error(
                    f"{counted(len(cells), 'value')} in {counted(self.n_columns, 'column')}",
                    "Give every line one value per column.",
                    line=number,
                )
            for column, cell in enumerate(cells):
                if not _is_number(cell):
                    return self._error(
                        f"{cell.strip()!r:.60} is not a finite number up to {NUMBER:g}",
                        "Write a decimal number there, such as -0.25.",
                        line=number,
                        column=column,
                    )
        return self._error("numpy cannot read it as numbers", "Give a plain CSV file.")

    def _check_columns(self) -> None:
        if self._missing or self._unknown:
            faults = [f"missing columns: {', '.join(self._missing)}"] if self._missing else []
            faults += [f"columns that are no joint: {', '.join(self._unknown)}"] * bool(
                self._unknown
            )
            raise self._error(
                "; ".join(faults),
                f"Name the columns {','.join(ROOT_COLUMNS[1:])} and the {len(JOINT_NAMES)} joints "
                "in any order, or use the 36 columns of LAFAN1 and no header.",
                line=1,
            )

    def _check_frame_numbers(self) -> None:
        # Whole numbers that rise by one. The first may be any, as in a clip.
        if _FRAME not in self.columns:
            return
        numbers = self._take([_FRAME])[:, 0]
        wrong = np.flatnonzero((np.diff(numbers) != 1) | (numbers[1:] != np.rint(numbers[1:])))
        if wrong.size:
            row = int(wrong[0]) + 1
            raise self._error(
                f"frame {numbers[row]:.12g} follows frame {numbers[row - 1]:.12g}",
                "Number the frames 0, 1, 2 and so on, one per line.",
                line=self._line(row),
                column=self.columns.index(_FRAME),
            )

    def _check_norms(self, norms: Floats) -> tuple[str, ...]:
        """A warning about quaternion norms (T,) that are not 1; an error for one that is 0."""
        if norms.min() <= SMALLEST_QUAT:
            row = int(np.argmin(norms))
            raise self._error(
                "the quaternion QX,QY,QZ,QW is zero",
                "Give every frame an orientation; without rotation it is 0,0,0,1.",
                line=self._line(row),
                column=self.columns.index("QX"),
            )
        return norm_warnings(
            norms, self._file.path.name, lambda frame: f"frame {frame}, line {self._line(frame)}"
        )


def _canonical_column(column: str) -> str:
    """The name of a column as g1stream writes it, where it is another name for the same."""
    lower = column.lower()
    if lower in _OTHER_NAMES:
        return _OTHER_NAMES[lower]
    joint = f"{lower.removesuffix('_joint')}_joint"
    return joint if joint in JOINT_NAMES else column


def _is_number(cell: str) -> bool:
    """Whether a cell holds a decimal number of a sane size."""
    if "_" in cell or not cell.isascii():
        return False
    try:
        return abs(float(cell)) <= NUMBER
    except ValueError:
        return False
