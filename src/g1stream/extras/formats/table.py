"""The motion formats of other programs, by the marks in a file and by the name for `--to`.

To add a format, add one file, and one row for what it reads, one for what it writes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.input_limits import CSV_LINE
from g1stream.motion.readers import Format

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from g1stream.motion.readers import MotionFile

__all__ = ["FORMATS", "WRITTEN", "is_sonic"]

#: The start of files compressed with zlib or gzip.
_COMPRESSED: Final = (b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda", b"\x1f\x8b")
_ARRAYS: Final = "g1stream.extras.formats.arrays:open_arrays"


def is_sonic(path: Path) -> bool:
    """Whether a path is a directory with SONIC's tables; False if it cannot be read."""
    try:
        return (path / "joint_pos.csv").is_file()
    except OSError:  # for example, the name is too long
        return False


def _begins(*starts: bytes) -> Callable[[MotionFile], bool]:
    return lambda file: file.content.startswith(starts)


def _is_text(file: MotionFile) -> bool:
    """Whether a file has a table's suffix, a first line like a table's, or is empty."""
    named = file.path.suffix.lower() in (".csv", ".txt")
    first = file.content[:CSV_LINE].split(b"\n", 1)[0]
    return named or b"," in first or not first


FORMATS: Final = (
    Format(
        "directory of SONIC",
        "g1stream.extras.formats.sonic:open_sonic",
        lambda file: file.data is None and is_sonic(file.path),
    ),
    Format("NPZ, file of PyTorch", _ARRAYS, _begins(b"PK"), several=True),
    Format("NPY", _ARRAYS, _begins(b"\x93NUMPY")),
    Format("pickle", _ARRAYS, _begins(b"\x80", *_COMPRESSED), several=True),
    Format("CSV", "g1stream.extras.formats.text:open_text", _is_text),
)
"""The formats that are read, in the order in which they are asked, after those of the core."""

WRITTEN: Final = {
    "beyondmimic": "g1stream.extras.formats.beyondmimic:BEYONDMIMIC",
    "mjlab": "g1stream.extras.formats.beyondmimic:MJLAB",
    "holosoma": "g1stream.extras.formats.holosoma:HOLOSOMA",
    "sonic": "g1stream.extras.formats.sonic:SONIC",
    "lafan1": "g1stream.extras.formats.lafan1:LAFAN1",
    "gmr": "g1stream.extras.formats.gmr:GMR",
}
"""The formats that are written, by name: each an `Output`."""
