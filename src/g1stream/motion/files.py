"""Finds a motion file and picks the class that reads its format.

A further format is a class such as `CsvFile` in a file of its own; `open_motion_file` distinguishes
formats by the first bytes. Session files are read a layer above, in session/motions.py.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.errors import MotionError
from g1stream.files import read_file
from g1stream.motion.csv import CsvFile

if TYPE_CHECKING:
    import os

__all__ = ["BUNDLED_MOTIONS", "open_motion_file"]

BUNDLED_MOTIONS: Final = ("demo",)
"""Names of the motions in this package."""

#: Bytes of a motion file; an hour at 500 Hz has as many.
_LARGEST: Final = 2**30


def open_motion_file(path_or_name: str | os.PathLike[str]) -> CsvFile:
    """Open a motion file, or a bundled motion by its name.

    Raises:
        MotionError: there is no such file, or it cannot be read, or is empty, or is not text.
    """
    path = Path(path_or_name)
    if path_or_name in BUNDLED_MOTIONS:
        path = Path(str(resources.files("g1stream.motion") / f"{path_or_name}.csv"))
    return CsvFile(path, _read(path))


def _read(path: Path) -> bytes:
    try:
        return read_file(path, _LARGEST)
    except FileNotFoundError:
        raise MotionError(
            f"There is no motion file {path}.",
            "Give the path of a CSV file or of a session file, or the name of a bundled motion: "
            f"{', '.join(BUNDLED_MOTIONS)}.",
        ) from None
    except OSError as error:
        raise MotionError(
            f"The motion file {path} cannot be read: {error.strerror}.",
            "Give the path of a CSV file that you may read; save what comes from a pipe first.",
        ) from None
