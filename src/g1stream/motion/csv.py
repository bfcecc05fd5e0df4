"""Motions in CSV: the layout of the Foxglove tutorial, which g1stream writes, and LAFAN1's.

A header names the columns: those of `ROOT_COLUMNS`, with or without the frame number, and the 29
joints, in any order. LAFAN1 as distributed for the G1 has no header: position, quaternion (xyzw)
and the joints in motor order. Without names evidence decides, if the extra `formats` is there; it
reads all other tables, too.

numpy parses the numbers. Its errors have few details, so a faulty table is then searched cell by
cell for the first fault.
"""

from __future__ import annotations

from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import ConfigError, MotionError
from g1stream.input_limits import CSV_LINE, NUMBER
from g1stream.motion.motion import ROOT_COLUMNS
from g1stream.motion.readers import Evidence, Poses
from g1stream.optional import extension
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS
from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from g1stream.motion.motion import Motion
    from g1stream.motion.readers import MotionFile
    from g1stream.types import Floats

__all__ = ["TextTable", "cells_of", "is_number", "open_csv", "take_columns", "write_csv"]

_FRAME: Final = ROOT_COLUMNS[0]
_POSITION: Final = ROOT_COLUMNS[1:4]
_QUAT_XYZW: Final = ROOT_COLUMNS[4:]
#: Numbers of a pose of the pelvis.
_POSE: Final = 7
_BOM: Final = b"\xef\xbb\xbf"


def open_csv(file: MotionFile) -> Poses | None:
    """Open a CSV; None if its columns are others.

    Raises:
        MotionError: it is no table of numbers. It names line and column.
    """
    table = TextTable(file.content, file.path.name)
    first, second = (*islice(table.lines(), 2), "", "")[:2]
    columns = cells_of(first)
    if "," not in second:
        return None
    if sorted({_FRAME, *columns}) == sorted((*ROOT_COLUMNS, *JOINT_NAMES)):
        table.columns = columns
        return _named(file, table) if len(set(columns)) == len(columns) else None
    with suppress(ConfigError):
        extension("motion_formats")
        return None
    return _lafan1(file, table) if len(columns) == _POSE + N_JOINTS else None


def _named(file: MotionFile, table: TextTable) -> Poses:
    """The poses below a header."""
    values = table.values(2, len(table.columns))
    column = {name: i for i, name in enumerate(table.columns)}
    if _FRAME in column:
        table.check_frame_numbers(values[:, column[_FRAME]])
    parts = JOINT_NAMES, _POSITION, _QUAT_XYZW
    joint_pos, root_pos, quat = (take_columns(values, [column[n] for n in one]) for one in parts)
    order = "wxyz" if column["QW"] < column["QX"] else "xyzw"
    used = {"file": f"CSV, {table.size}, named by a header", "joint order": "named by the file"}
    used["pelvis"] = f"root_pos, root_quat_{order}, {order}"
    evidence = Evidence(used, usual=True)
    return Poses(file, evidence, joint_pos, root_pos, wxyz_from_xyzw(quat), first_line=2)


def _lafan1(file: MotionFile, table: TextTable) -> Poses:
    """The poses in a table without a header, in the layout of LAFAN1."""
    values = table.values(1, _POSE + N_JOINTS)
    assumed = {"joint order": "motor", "pelvis": "the columns before the joints, xyzw"}
    evidence = Evidence({"file": f"CSV, {table.size}, no header"}, assumed)
    quat = wxyz_from_xyzw(values[:, 3:_POSE])
    return Poses(file, evidence, values[:, _POSE:], values[:, :3], quat, first_line=1)


def write_csv(motion: Motion, path: Path) -> None:
    """Write the Foxglove layout, with all digits of every number."""
    table = [motion.root_pos, xyzw_from_wxyz(motion.root_quat_wxyz), motion.joint_pos]
    rows = np.concatenate(table, axis=1).tolist()
    lines = [",".join((*ROOT_COLUMNS, *motion.joint_names))]
    lines += [f"{frame}," + ",".join(map(repr, row)) for frame, row in enumerate(rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


class TextTable:
    """A table of numbers in text, with a row per frame.

    Args:
        content: UTF-8 text. A byte order mark, all line ends, spaces around cells and blank lines
            at the end are accepted.
        name: name of the file, for errors.

    Attributes:
        columns: names of the columns, for errors; empty if they have none.
    """

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
        self.columns: Sequence[str] = ()
        self._first_line = self._n_rows = self._n_columns = 0

    @property
    def size(self) -> str:
        """The number of rows and columns that were read, as text."""
        return f"{counted(self._n_rows, 'row')}, {counted(self._n_columns, 'column')}"

    def lines(self) -> Iterator[str]:
        """The lines of the text, except blank ones at its end."""
        start, number = 0, 1
        while start < self._end:
            stop = self._data.find(b"\n", start, min(self._end, start + CSV_LINE + 1))
            if stop < 0:
                stop = self._end
                if stop - start > CSV_LINE:
                    raise self.error(
                        f"it is longer than {CSV_LINE:,} bytes", "Give a line per frame.", number
                    )
            try:
                line = self._data[start:stop].decode()
            except UnicodeDecodeError as error:
                raise self.error(
                    f"byte {start + error.start} is not UTF-8 text",
                    "Give a CSV file in UTF-8, an NPZ, a pickle of arrays, or a session.",
                    number,
                ) from None
            if "\0" in line:
                raise self.error("it is binary, not text", "Give a motion file.", number)
            yield line
            start, number = stop + 1, number + 1

    def values(self, first_line: int, n_columns: int, delimiter: str | None = ",") -> Floats:
        """Read the numbers (T, N), all finite.

        Args:
            first_line: line of frame 0, from 1.
            n_columns: number of columns, N.
            delimiter: what separates cells; spaces if None.

        Raises:
            MotionError: a cell or a line is wrong. It names line and column.
        """
        self._first_line, self._n_columns = first_line, n_columns
        self._n_rows = self._data.count(b"\n", 0, self._end) + 2 - first_line
        try:
            lines = islice(self.lines(), first_line - 1, None)
            values = np.loadtxt(lines, delimiter=delimiter, comments=None, ndmin=2)
        except ValueError:
            raise self._first_fault(delimiter) from None
        within = values.min() >= -NUMBER and values.max() <= NUMBER  # False for NaN
        if not within or values.shape != (self._n_rows, self._n_columns):
            raise self._first_fault(delimiter)
        return values

    def error(
        self, cause: str, remedy: str, line: int | None = None, column: int | None = None
    ) -> MotionError:
        """An error with its line, counted from 1, and its column, counted from 0."""
        where = self._name
        if line is not None:
            where += f", line {line}"
        if column is not None:
            where += f", column {column + 1}"
            where += f" ({self.columns[column]})" if any(self.columns[column:][:1]) else ""
        return MotionError(f"{where}: {cause}.", remedy)

    def _first_fault(self, delimiter: str | None) -> MotionError:
        """An error about the first faulty cell or line."""
        for number, line in enumerate(self.lines(), 1):
            if number < self._first_line:
                continue
            cells = line.split(delimiter)
            if not line.strip():
                return self.error("the line is blank", "Remove it.", number)
            if len(cells) != self._n_columns:
                return self.error(
                    f"{counted(len(cells), 'value')} in {counted(self._n_columns, 'column')}",
                    "Give every line one value per column.",
                    number,
                )
            for column, cell in enumerate(cells):
                if not is_number(cell):
                    return self.error(
                        f"{cell.strip()!r:.60} is not a finite number up to {NUMBER:g}",
                        "Write a decimal number there, such as -0.25.",
                        number,
                        column,
                    )
        return self.error("numpy cannot read it as numbers", "Give a plain CSV file.")

    def check_frame_numbers(self, numbers: Floats) -> None:
        """Check the column with the frame numbers (T,).

        Raises:
            MotionError: they do not increase by one.
        """
        # Whole numbers that increase by one. A clip may start at any number.
        wrong = np.flatnonzero((np.diff(numbers) != 1) | (numbers[1:] != np.rint(numbers[1:])))
        if wrong.size:
            row = int(wrong[0]) + 1
            raise self.error(
                f"frame {numbers[row]:.12g} follows frame {numbers[row - 1]:.12g}",
                "Number the frames 0, 1, 2 and so on, one per line.",
                self._first_line + row,
                list(self.columns).index(_FRAME),
            )


def cells_of(line: str) -> list[str]:
    """The cells of a line, separated by commas, or by spaces if it has none."""
    return [cell.strip() for cell in line.split("," if "," in line else None)]


def take_columns(values: Floats, columns: Sequence[int]) -> Floats:
    """Some columns; a view if they are adjacent."""
    first = columns[0]
    if list(columns) == list(range(first, first + len(columns))):
        return values[:, first : first + len(columns)]
    return values[:, columns]


def is_number(cell: str) -> bool:
    """Whether a cell holds a decimal number of a plausible size."""
    if "_" in cell or not cell.isascii():
        return False
    try:
        return abs(float(cell)) <= NUMBER
    except ValueError:
        return False
