"""Motion tables in CSV, or separated by spaces as from `numpy.savetxt`, with a row per frame.

A header names the columns: those of `ROOT_COLUMNS` and the joints, in any order. Other names such
as `root_pos_x`, `quat_w` and `left_knee` work, too. The header may be in quotes, or a comment.
Without a header `g1stream.motion.arrays` detects the columns.

numpy parses the numbers. Its errors have few details, so a faulty table is then searched cell by
cell for the first fault.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.errors import MotionError
from g1stream.input_limits import CSV_LINE, NUMBER
from g1stream.motion.motion import ROOT_COLUMNS
from g1stream.robot.joints import JOINT_NAMES
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from g1stream.types import Floats

__all__ = ["Table", "read_csv"]

_FRAME: Final = ROOT_COLUMNS[0]
_POSITION: Final = ROOT_COLUMNS[1:4]
_QUAT_XYZW: Final = ROOT_COLUMNS[4:]
_QUAT_WXYZ: Final = (_QUAT_XYZW[-1], *_QUAT_XYZW[:-1])
#: Names of the root's columns in other tools.
_OTHER_NAMES: Final = {
    prefix + axis.lower()[-1]: axis
    for axes, prefixes in (
        (_POSITION, ("", "pos_", "root_", "root_pos_", "base_", "base_pos_")),
        (_QUAT_XYZW, ("q", "quat_", "rot_", "root_q", "root_quat_", "root_rot_", "base_quat_")),
    )
    for axis in axes
    for prefix in prefixes
} | {"frame": _FRAME}
#: Parts of the names of columns with Euler angles.
_EULER: Final = ("rotate", "euler", "roll", "pitch", "yaw", "rpy")
_JOINTS: Final = frozenset(JOINT_NAMES)
#: The first row of numbers must be within this number of lines.
_HEADER: Final = 1000
_BOM: Final = b"\xef\xbb\xbf"
_LAYOUT: Final = (
    f"Separate columns with commas or spaces, and name {','.join(ROOT_COLUMNS[1:])} and the "
    f"{len(JOINT_NAMES)} joints in the first line; or give position, quaternion (xyzw) and joints "
    "without a header."
)


class Table(NamedTuple):
    """The content of a CSV file.

    Attributes:
        about: description for messages.
        arrays: `joint_pos`, `joint_names`, `root_pos`, `root_quat_xyzw` (`root_quat_wxyz` if W is
            before X in the file), and each other column by its name; without a header only
            `table`, (T, N).
        first_line: line of frame 0, from 1.
    """

    about: str
    arrays: dict[str, Any]
    first_line: int


def read_csv(content: bytes, name: str) -> Table:
    """Read the columns of a table.

    Args:
        content: UTF-8 text. A byte order mark, all line ends, spaces around cells and blank lines
            at the end are accepted.
        name: name of the file, for errors.

    Raises:
        MotionError: it is no table of numbers, or not one of a robot. It names line and column.
    """
    return _Reader(content, name).table()


class _Reader:
    def __init__(self, content: bytes, name: str) -> None:
        self._name = name
        self._data = content.removeprefix(_BOM)
        if b"\r" in self._data:
            self._data = self._data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        self._end, tail = len(self._data), b""
        while self._end and not tail:
            start = max(0, self._end - CSV_LINE)
            tail = self._data[start : self._end].rstrip()
            self._end = start + len(tail)
        header, self._named, line = "", False, ""
        self._header_line = 0
        self._columns: tuple[str, ...] = ()
        for number, line in enumerate(islice(self._lines(), _HEADER), 1):
            self._first_line = number
            comment = line.startswith("#")
            if not comment and (self._named or any(map(_is_number, _cells(line)))):
                break
            header, self._named = line.lstrip("# "), self._named or not comment
            self._header_line = number
        else:
            cause = "it has a header but no frame" if header else "the file is empty"
            raise self._error(cause, "Give a CSV file with a line per frame, or a session file.")
        self._delimiter = "," if "," in line else None
        self._n_columns = len(_cells(line))
        names = [cell.strip("\"'") for cell in _cells(header)]
        # Such a comment may not be a header.
        if names and (self._named or len(names) == self._n_columns):
            names[0] = names[0] or _FRAME  # pandas writes an index without a name
            self._columns = tuple(map(_canonical_column, names))
            self._n_columns = len(names)
        self._n_rows = self._data.count(b"\n", 0, self._end) + 2 - self._first_line

    def table(self) -> Table:
        size = f"{counted(self._n_rows, 'row')}, {counted(self._n_columns, 'column')}"
        if not self._columns:
            return Table(f"{size}, no header", {"table": self._values()}, self._first_line)
        self._check_header()
        values = self._values()
        numbered = {name: column for column, name in enumerate(self._columns)}
        arrays: dict[str, Any] = {"joint_names": [n for n in self._columns if n in _JOINTS]}
        parts = {"joint_pos": arrays["joint_names"]}
        if _QUAT_XYZW[0] in numbered:
            w_first = numbered[_QUAT_WXYZ[0]] < numbered[_QUAT_WXYZ[1]]
            quat = {"root_quat_wxyz": _QUAT_WXYZ} if w_first else {"root_quat_xyzw": _QUAT_XYZW}
            parts |= {"root_pos": _POSITION, **quat}
        for key, names in parts.items():
            arrays[key] = _take(values, [numbered[name] for name in names])
        if _FRAME in numbered:
            self._check_frame_numbers(values[:, numbered[_FRAME]])
        known = _JOINTS.union(ROOT_COLUMNS)
        arrays |= {name: values[:, i] for name, i in numbered.items() if name not in known}
        return Table(f"{size}, named by a header", arrays, self._first_line)

    def _lines(self) -> Iterator[str]:
        """The lines of the text, except blank ones at its end."""
        start, number = 0, 1
        while start < self._end:
            stop = self._data.find(b"\n", start, min(self._end, start + CSV_LINE + 1))
            if stop < 0:
                stop = self._end
                if stop - start > CSV_LINE:
                    raise self._error(
                        f"it is longer than {CSV_LINE:,} bytes", "Give a line per frame.", number
                    )
            try:
                line = self._data[start:stop].decode()
            except UnicodeDecodeError as error:
                raise self._error(
                    f"byte {start + error.start} is not UTF-8 text",
                    "Give a CSV file in UTF-8, an NPZ, a pickle of arrays, or a session.",
                    number,
                ) from None
            if "\0" in line:
                raise self._error("it is binary, not text", "Give a motion file.", number)
            yield line
            start, number = stop + 1, number + 1

    def _values(self) -> Floats:
        """The numbers (T, N), all finite."""
        try:
            lines = islice(self._lines(), self._first_line - 1, None)
            values = np.loadtxt(lines, delimiter=self._delimiter, comments=None, ndmin=2)
        except ValueError:
            raise self._first_fault() from None
        within = values.min() >= -NUMBER and values.max() <= NUMBER  # False for NaN
        if not within or values.shape != (self._n_rows, self._n_columns):
            raise self._first_fault()
        return values

    def _error(
        self, cause: str, remedy: str, line: int | None = None, column: int | None = None
    ) -> MotionError:
        """An error with its line, counted from 1, and its column, counted from 0."""
        where = self._name
        if line is not None:
            where += f", line {line}"
        if column is not None:
            where += f", column {column + 1}"
            where += f" ({self._columns[column]})" if any(self._columns[column:][:1]) else ""
        return MotionError(f"{where}: {cause}.", remedy)

    def _check_header(self) -> None:
        seen = set[str]()
        for column, name in enumerate(self._columns):
            if not name or name in seen:
                raise self._error(
                    "another column has the same name" if name else "the header has an empty name",
                    "Give each column a unique name, and end no line with a comma.",
                    self._header_line,
                    column,
                )
            seen.add(name)
        missing = [name for name in ROOT_COLUMNS[1:] if name not in seen]
        named = len(missing) < len(ROOT_COLUMNS) - 1
        euler = [name for name in self._columns if name not in _JOINTS and _is_euler(name)]
        if missing and len(euler) == len(_POSITION):
            raise self._error(
                f"the root is in Euler angles ({', '.join(euler)}), as in BONES-SEED, whose angles "
                "are in degrees and whose positions are in centimetres",
                "Convert them to a quaternion QX,QY,QZ,QW, to radians and to metres.",
                self._header_line,
            )
        if not _JOINTS & seen or (missing and named):
            lacks = ", ".join(missing) if named else "joint names"
            raise self._error(f"the header lacks {lacks}", _LAYOUT, self._header_line)

    def _first_fault(self) -> MotionError:
        """An error about the first faulty cell or line."""
        for number, line in enumerate(self._lines(), 1):
            if number < self._first_line:
                continue
            cells = line.split(self._delimiter)
            if not line.strip():
                return self._error("the line is blank", "Remove it.", number)
            if len(cells) != self._n_columns:
                return self._error(
                    f"{counted(len(cells), 'value')} in {counted(self._n_columns, 'column')}",
                    "Give every line one value per column.",
                    number,
                )
            for column, cell in enumerate(cells):
                if not _is_number(cell):
                    return self._error(
                        f"{cell.strip()!r:.60} is not a finite number up to {NUMBER:g}",
                        "Write a decimal number there, such as -0.25.",
                        number,
                        column,
                    )
        return self._error("numpy cannot read it as numbers", "Give a plain CSV file.")

    def _check_frame_numbers(self, numbers: Floats) -> None:
        # Whole numbers that increase by one. A clip may start at any number.
        wrong = np.flatnonzero((np.diff(numbers) != 1) | (numbers[1:] != np.rint(numbers[1:])))
        if wrong.size:
            row = int(wrong[0]) + 1
            raise self._error(
                f"frame {numbers[row]:.12g} follows frame {numbers[row - 1]:.12g}",
                "Number the frames 0, 1, 2 and so on, one per line.",
                self._first_line + row,
                self._columns.index(_FRAME),
            )


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("," if "," in line else None)]


def _take(values: Floats, columns: Sequence[int]) -> Floats:
    """Some columns; a view if they are adjacent."""
    first = columns[0]
    if list(columns) == list(range(first, first + len(columns))):
        return values[:, first : first + len(columns)]
    return values[:, columns]


def _canonical_column(column: str) -> str:
    """The name of a column as g1stream writes it, for known synonyms."""
    lower = column.lower()
    joint = f"{lower.removesuffix('_joint')}_joint"
    return _OTHER_NAMES.get(lower, joint if joint in _JOINTS else column)


def _is_euler(column: str) -> bool:
    lower = column.lower()
    return not lower.endswith(("_joint", "_dof")) and any(word in lower for word in _EULER)


def _is_number(cell: str) -> bool:
    """Whether a cell holds a decimal number of a plausible size."""
    if "_" in cell or not cell.isascii():
        return False
    try:
        return abs(float(cell)) <= NUMBER
    except ValueError:
        return False
