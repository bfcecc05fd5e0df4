"""Motion files below directories, and what they contain."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from g1stream.errors import ConfigError, MotionError
from g1stream.input_limits import MOTION_FILE

#: Of the files in a directory that may be motions; a file that is named is read whatever its name.
_SUFFIXES: Final = {
    *(".csv", ".npz", ".npy"),
    *(".pkl", ".pickle", ".joblib", ".pt", ".pth"),
    *(".mcap", ".db3"),
}
#: A directory with this file is a recording in parts, or a bag of ROS 2: one motion.
_BAG: Final = "metadata.yaml"
LIBRARY: Final = ".g1stream-library"
"""The file in each library's directory; its tables and what it wrote are no motions to look at."""


def find_motions(places: Sequence[str]) -> list[str]:
    """The absolute paths of the motion files below directories and files, in order, each once.

    A directory stands for the files below it whose names end like those of motion files, and for
    its recordings in parts; libraries and hidden files and directories are left out, links to
    directories not followed.
    """
    return list(dict.fromkeys(path for place in places for path in _below(place)))


def _below(place: str) -> Iterator[str]:
    path = Path(place).absolute()
    if not path.exists():
        raise ConfigError(f"There is no {place}.", "Give motion files, or directories with some.")
    if not path.is_dir():
        yield str(path)
        return
    for directory, names, files in os.walk(path):
        names[:] = sorted(name for name in names if not name.startswith("."))
        if _BAG in files or LIBRARY in files:
            names.clear()
            if _BAG in files:
                yield directory
            continue
        for name in sorted(files):
            one = Path(directory, name)
            if one.suffix.lower() in _SUFFIXES and not name.startswith(".") and one.is_file():
                yield str(one)


def content_hash(path: Path) -> str:
    """SHA-256 of a file, in hex; of a directory, of its files in order.

    Raises:
        MotionError: it cannot be read, is too large, or is not a file.
    """
    digest = hashlib.sha256()
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
            f"{path} cannot be read: {error.strerror or error}.",
            "Check that it is there and that you may read it.",
        ) from error
    return digest.hexdigest()
