"""A CSV of numbers -> named columns, with an error that points at the very cell.

Numpy reads the cells, quickly and in little memory, but says little about what it refuses. A file
that it does not take as a whole is read anew cell by cell, with `float`: what `float` refuses is an
error, and so is what it takes beyond plain decimal numbers (underscores, digits of other scripts,
nan, inf).
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from g1stream.errors import MotionError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Outline", "Table", "outline_table", "read_table"]


@dataclass(frozen=True)
class Outline:
    """What a table shows before its numbers are looked at.

    Attributes:
        columns: their names in the file's order; none where nothing names them.
        n_columns: how many values the first line has.
        header_line: the line of the header, None if the file has none.
        n_rows: lines below the header, to the last that is not blank.
    """

    columns: tuple[str, ...]
    n_columns: int
    header_line: int | None
    n_rows: int


@dataclass(frozen=True)
class Table:
    """Numbers in named columns.

    Attributes:
        name: of the file, for messages.
        columns: their names in the file's order.
        header_line: the line of the header, None if the file has none.
        values: (rows, columns) float64, all finite.
    """

    name: str
    columns: tuple[str, ...]
    header_line: int | None
    values: NDArray[np.float64]

    def __getitem__(self, columns: Sequence[str]) -> NDArray[np.float64]:
        """The named columns, in the order named: (rows, len(columns))."""
        places = {name: place for place, name in enumerate(self.columns)}
        return self.values.take([places[name] for name in columns], axis=1)

    def line(self, row: int) -> int:
        """The line of the file, from 1, that a row stands on."""
        return row + 1 + (self.header_line or 0)

    def where(self, row: int, column: str) -> str:
        """A cell's place in words."""
        place = self.columns.index(column) + 1
        return f"{self.name}, line {self.line(row)}, column {place} ({column})"


def outline_table(name: str, content: bytes, headerless: tuple[str, ...]) -> Outline:
    """Look at the first line of a comma-separated table: a header if it holds no number.

    Args:
        name: of the file, for messages.
        content: its bytes, UTF-8.
        headerless: the columns of a file without a header.

    Raises:
        MotionError: the content is empty, or no text.
    """
    cells = tuple(cell.strip() for cell in _first_line(name, content).split(","))
    n_lines = content.rstrip().count(b"\n") + 1
    if any(_is_number(cell) for cell in cells):
        names = headerless if len(cells) == len(headerless) else ()
        return Outline(names, len(cells), None, n_lines)
    return Outline(cells if len(cells) > 1 else (), len(cells), 1, n_lines - 1)


def read_table(name: str, content: bytes, headerless: tuple[str, ...]) -> Table:
    """Read a comma-separated table of numbers.

    The first line is a header if it holds no number. Spaces around cells, CRLF, a byte order mark
    and blank lines at the end are of no account.

    Args:
        name: of the file, for messages.
        content: its bytes, UTF-8.
        headerless: the columns of a file without a header.

    Raises:
        MotionError: the content is no such table; says where (line, column).
    """
    outline = outline_table(name, content, headerless)
    _check_columns(name, outline, headerless)
    values = _read_quickly(content, outline)
    if values is None:
        values = _read_closely(name, _lines(name, content), outline)
    return Table(name, outline.columns, outline.header_line, values)


def _first_line(name: str, content: bytes) -> str:
    if content.isascii() and b"\0" not in content and content.strip():
        return BytesIO(content).readline().decode()
    return _lines(name, content)[0]


def _read_quickly(content: bytes, outline: Outline) -> NDArray[np.float64] | None:
    """The values, or None where there is anything in the file to look at more closely."""
    if not outline.n_rows or not content.isascii():
        return None
    skipped = outline.header_line or 0
    try:
        values = np.loadtxt(
            BytesIO(content), delimiter=",", comments=None, skiprows=skipped, ndmin=2
        )
    except ValueError:
        return None
    shape = (outline.n_rows, outline.n_columns)
    whole = values.shape == shape and bool(np.isfinite(values).all())
    return values if whole else None


def _lines(name: str, content: bytes) -> list[str]:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise MotionError(
            f"{name}, line {line}: byte {error.start} is not UTF-8 text.",
            "Give a CSV file, saved as UTF-8, or a session file.",
        ) from None
    if "\0" in text:
        raise MotionError(
            f"{name} is a binary file: byte {text.index(chr(0))} is zero.",
            "Give a CSV file or a session file.",
        )
    lines = text.replace("\r\n", "\n").rstrip().split("\n")
    if lines == [""]:
        raise MotionError(
            f"{name} is empty.", "Give a CSV file with a line a frame, or a session file."
        )
    return lines


def _check_columns(name: str, outline: Outline, headerless: tuple[str, ...]) -> None:
    columns = outline.columns
    if outline.header_line is None and not columns:
        raise MotionError(
            f"{name}, line 1: {outline.n_columns} values, and no header that names them.",
            f"Without a header there must be {len(headerless)} columns: {','.join(headerless[:8])} "
            "and the other joints in motor order. Otherwise put a header first.",
        )
    if not columns:
        raise MotionError(
            f"{name}, line 1: there are no columns separated by commas.",
            "Give a CSV file with commas between its values.",
        )
    for place, column in enumerate(columns):
        if not column:
            raise MotionError(
                f"{name}, line 1, column {place + 1}: the header has an empty name.",
                "Name every column, and end no line with a comma.",
            )
        first = columns.index(column)
        if first != place:
            raise MotionError(
                f"{name}, line 1: columns {first + 1} and {place + 1} are both named {column}.",
                "Give each column a name of its own.",
            )


def _read_closely(name: str, lines: list[str], outline: Outline) -> NDArray[np.float64]:
    columns, n_header_lines = outline.columns, outline.header_line or 0
    if len(lines) == n_header_lines:
        raise MotionError(f"{name} has a header but no frames.", "Give it a line a frame.")
    rows: list[list[float]] = []
    for number, line in enumerate(lines[n_header_lines:], start=n_header_lines + 1):
        cells = line.split(",")
        try:
            row = list(map(float, cells))
        except ValueError:
            _refuse(name, number, cells, columns)
        if len(row) != len(columns) or "_" in line or not line.isascii():
            _refuse(name, number, cells, columns)
        rows.append(row)
    values = np.array(rows)
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row_of_bad = int(bad[0, 0]) + n_header_lines
        _refuse(name, row_of_bad + 1, lines[row_of_bad].split(","), columns)
    return values


def _is_number(cell: str) -> bool:
    """Whether a cell holds a finite decimal number."""
    if "_" in cell or not cell.isascii():
        return False
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def _refuse(name: str, number: int, cells: list[str], columns: tuple[str, ...]) -> NoReturn:
    """Say what is wrong with a line that cannot be used."""
    if not "".join(cells).strip():
        raise MotionError(f"{name}, line {number}: the line is blank.", "Take it out.")
    if len(cells) != len(columns):
        fault = "short" if len(cells) < len(columns) else "long"
        raise MotionError(
            f"{name}, line {number}: the row is too {fault}, with {len(cells)} values for "
            f"{len(columns)} columns.",
            "Give every line one value a column.",
        )
    place, cell = next((i, c) for i, c in enumerate(cells) if not _is_number(c))
    fault = f"{cell.strip(' ')!r} is not a finite number" if cell.strip() else "there is no value"
    raise MotionError(
        f"{name}, line {number}, column {place + 1} ({columns[place]}): {fault}.",
        "Write a decimal number there, such as -0.25.",
    )
