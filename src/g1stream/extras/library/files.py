"""Motion files below paths, and their content."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.errors import ConfigError, G1StreamError, MotionError
from g1stream.extras.formats.arrays import motions_in
from g1stream.extras.formats.table import is_sonic
from g1stream.input_limits import MOTION_FILE
from g1stream.motion.readers import find_motion

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["LIBRARY", "content_hash", "find_motions", "motions_at"]

#: Suffixes of files that may have several motions.
_SEVERAL: Final = {".pkl", ".pickle", ".joblib", ".pt", ".pth", ".motion"}
#: Suffixes of motion files in a directory. A file that is given itself is read with any suffix.
_SUFFIXES: Final = _SEVERAL | {".csv", ".npz", ".npy", ".mcap", ".db3"}
#: A directory with this file is a bag of ROS 2 and counts as one motion. So does one of SONIC.
_BAG: Final = "metadata.yaml"
LIBRARY: Final = ".g1stream-library"
"""The file in each library's directory. Libraries are not searched for motions."""


def find_motions(places: Sequence[str]) -> list[str]:
    """Find the motion files below directories and files, in order and without duplicates.

    A directory stands for the files below it with suffixes of motion files, and for its bags
    of ROS 2 and directories of SONIC. Libraries and hidden files and directories are skipped, and
    links to directories are not followed.

    Args:
        places: paths, one in a file of several as `library.pkl:walk`.

    Returns:
        Absolute paths.

    Raises:
        ConfigError: a place does not exist.
    """
    return list(dict.fromkeys(path for place in places for path in _below(place)))


def _below(place: str) -> Iterator[str]:
    path = Path(place).absolute()
    if not path.exists() and not find_motion(path).path.is_file():  # path of a file's member
        raise ConfigError(
            f"There is no {place}.", "Give motion files, or directories with motion files."
        )
    if not path.is_dir():
        yield str(path)
        return
    for directory, names, files in os.walk(path):
        names[:] = sorted(name for name in names if not name.startswith("."))
        one = _BAG in files or is_sonic(Path(directory))
        if one or LIBRARY in files:
            names.clear()
            if one:
                yield directory
            continue
        for file in sorted(Path(directory, name) for name in files):
            hidden = file.name.startswith(".")
            if file.suffix.lower() in _SUFFIXES and not hidden and file.is_file():
                yield str(file)


def motions_at(location: str) -> tuple[str, tuple[str, ...]]:
    """The file at a path, and the names of its motions if it has several.

    A path may end with the name of one of them: `library.pkl:walk`.
    """
    file = find_motion(location)
    if file.member:
        return str(file.path), (file.member,)
    if Path(location).suffix.lower() in _SEVERAL:
        # Errors are reported when the file is read.
        with suppress(G1StreamError, MemoryError):
            names = motions_in(file)
            return location, names if len(names) > 1 else ()
    return location, ()


def content_hash(location: str) -> str:
    """SHA-256 of the content at a path, in hex; for a directory, of its files in order.

    Raises:
        MotionError: it cannot be read, is too large, or is not a file.
    """
    digest, path = hashlib.sha256(), Path(location)
    parts = sorted(one for one in path.iterdir() if one.is_file()) if path.is_dir() else [path]
    try:
        for part in parts:
            if not part.is_file():
                raise OSError("it is not a file")
            if part.stat().st_size > MOTION_FILE:
                raise OSError(f"it has more than {MOTION_FILE / 2**20:g} MiB")
            with part.open("rb") as file:
                while block := file.read(2**20):
                    digest.update(block)
    except OSError as error:
        raise MotionError(
            f"{location} cannot be read: {error.strerror or error}.",
            "Check that it exists and that you may read it.",
        ) from error
    return digest.hexdigest()
