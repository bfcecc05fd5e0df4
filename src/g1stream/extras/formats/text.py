"""Tables in text with other columns or spellings than ours.

Names such as `root_pos_x`, `quat_w` and `left_knee` work, too. The header may be in quotes, or a
comment, and cells may be separated by spaces, as from `numpy.savetxt`. Without a header
`extras.formats.evidence` detects the columns.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from g1stream.extras.formats.evidence import TIMES, poses_of
from g1stream.motion.csv import TextTable, cells_of, is_number, take_columns
from g1stream.motion.motion import ROOT_COLUMNS
from g1stream.motion.readers import ATTACH
from g1stream.robot.joints import JOINT_NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.motion.readers import MotionFile, Poses

__all__ = ["Table", "open_text", "read_text"]

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


def open_text(file: MotionFile) -> Poses:
    """Open a table.

    Raises:
        MotionError: it is no table of numbers, or not one of a robot.
    """
    table = read_text(file.content, file.path.name)
    return poses_of(file, f"CSV, {table.about}", table.arrays, table.first_line)


def read_text(content: bytes, name: str) -> Table:
    """Read the columns of a table.

    Args:
        content: UTF-8 text, as of `TextTable`.
        name: name of the file, for errors.

    Raises:
        MotionError: it is no table of numbers, or not one of a robot. It names line and column.
    """
    text = TextTable(content, name)
    header, named, line = "", False, ""
    header_line = first_line = 0
    for number, line in enumerate(islice(text.lines(), _HEADER), 1):
        first_line = number
        comment = line.startswith("#")
        if not comment and (named or any(map(is_number, cells_of(line)))):
            break
        header, named, header_line = line.lstrip("# "), named or not comment, number
    else:
        cause = "it has a header but no frame" if header else "the file is empty"
        raise text.error(cause, "Give a CSV file with a line per frame, or a session file.")
    delimiter = "," if "," in line else None
    n_columns = len(cells_of(line))
    names = [cell.strip("\"'") for cell in cells_of(header)]
    # Such a comment may not be a header.
    if not names or not (named or len(names) == n_columns):
        values = text.values(first_line, n_columns, delimiter)
        return Table(f"{text.size}, no header", {"table": values}, first_line)
    names[0] = names[0] or _FRAME  # pandas writes an index without a name
    text.columns = tuple(map(_canonical_column, names))
    _check_header(text, header_line)
    values = text.values(first_line, len(names), delimiter)
    numbered = {name: column for column, name in enumerate(text.columns)}
    arrays: dict[str, Any] = {"joint_names": [n for n in text.columns if n in _JOINTS]}
    parts: dict[str, Sequence[str]] = {"joint_pos": arrays["joint_names"]}
    if _QUAT_XYZW[0] in numbered:
        w_first = numbered[_QUAT_WXYZ[0]] < numbered[_QUAT_WXYZ[1]]
        quat = {"root_quat_wxyz": _QUAT_WXYZ} if w_first else {"root_quat_xyzw": _QUAT_XYZW}
        parts |= {"root_pos": _POSITION, **quat}
    for key, of in parts.items():
        arrays[key] = take_columns(values, [numbered[one] for one in of])
    if _FRAME in numbered:
        text.check_frame_numbers(values[:, numbered[_FRAME]])
    known = _JOINTS.union(ROOT_COLUMNS)
    arrays |= {one: values[:, i] for one, i in numbered.items() if one not in known}
    return Table(f"{text.size}, named by a header", arrays, first_line)


def _check_header(text: TextTable, line: int) -> None:
    """Raise a MotionError if names of columns are wrong or missing."""
    seen = set[str]()
    for column, name in enumerate(text.columns):
        if not name or name in seen:
            raise text.error(
                "another column has the same name" if name else "the header has an empty name",
                "Give each column a unique name, and end no line with a comma.",
                line,
                column,
            )
        seen.add(name)
    missing = [name for name in ROOT_COLUMNS[1:] if name not in seen]
    named = len(missing) < len(ROOT_COLUMNS) - 1
    euler = [name for name in text.columns if name not in _JOINTS and _is_euler(name)]
    if missing and len(euler) == len(_POSITION):
        raise text.error(
            f"the root is in Euler angles ({', '.join(euler)}), as in BONES-SEED, whose angles "
            "are in degrees and whose positions are in centimetres",
            "Convert them to a quaternion QX,QY,QZ,QW, to radians and to metres.",
            line,
        )
    if not _JOINTS & seen or (missing and named):
        lacks = ", ".join(missing) if named else "joint names"
        is_log = not named and any(name.lower() in TIMES for name in text.columns)
        raise text.error(f"the header lacks {lacks}", ATTACH if is_log else _LAYOUT, line)


def _canonical_column(column: str) -> str:
    """The name of a column as g1stream writes it, for known synonyms."""
    lower = column.lower()
    joint = f"{lower.removesuffix('_joint')}_joint"
    return _OTHER_NAMES.get(lower, joint if joint in _JOINTS else column)


def _is_euler(column: str) -> bool:
    lower = column.lower()
    return not lower.endswith(("_joint", "_dof")) and any(word in lower for word in _EULER)
