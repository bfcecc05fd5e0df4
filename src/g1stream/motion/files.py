"""Finds a motion file and picks the class that reads its format.

Formats are distinguished by the first bytes. Session files are read a layer above, in
session/motions.py.
"""

from __future__ import annotations

from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

from g1stream.errors import MotionError
from g1stream.files import read_file
from g1stream.input_limits import MOTION_FILE
from g1stream.motion.array_file import ArrayFile, is_array_file
from g1stream.motion.csv import CsvFile

if TYPE_CHECKING:
    import os

    from g1stream.types import JointOrder


__all__ = ["BUNDLED_MOTIONS", "open_motion_file"]

BUNDLED_MOTIONS: Final = ("demo",)
"""Names of the motions in this package."""

#: How files begin that people have motions in, but that have no joint angles of a G1 as such.
_NOT_READ: Final = {
    b"HIERARCHY": "a BVH file, the motion of a skeleton that is still to be retargeted",
    b"Kaydara FBX Binary": "an FBX file, the motion of a skeleton that is still to be retargeted",
    b"#usda": "a USD stage",
    b"PXR-USDC": "a USD stage",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB": "a MATLAB file",
    b"PAR1": "a Parquet file",
    b"#ROSBAG V": "a bag of ROS 1",
    b"\x89PNG": "a PNG picture",
    b"\xff\xd8\xff": "a JPEG picture",
    b"GIF8": "a GIF picture",
    b"%PDF": "a PDF document",
    b"\x7fELF": "a program",
    b"{": "JSON",
    b"<": "XML, such as a URDF or MJCF",
}
#: Endings of files that are no text.
_BINARY: Final = {
    *(".npz", ".npy", ".mcap", ".db3"),
    *(".pkl", ".pickle", ".joblib", ".pt", ".pth"),
}
_READ: Final = (
    "Read are CSV, NPZ, NPY, pickles of arrays, files of PyTorch, session files, and bags "
    "of ROS 2 and MCAP files with joint states: docs/formats.md says with which content."
)


def open_motion_file(
    path_or_name: str | os.PathLike[str], joint_order: JointOrder | None = None
) -> CsvFile | ArrayFile:
    """Open a motion file, or a bundled motion by its name.

    Args:
        path_or_name: of the file; followed by `:NAME` for a motion in a file of several.
        joint_order: of the joints, where a file does not name them.

    Raises:
        MotionError: there is no such file, or it cannot be read, is empty, or of another format.
    """
    path, member = _of_member(Path(path_or_name))
    if path_or_name in BUNDLED_MOTIONS:
        path = Path(str(resources.files("g1stream.motion") / f"{path_or_name}.csv"))
    return motion_file(path, _read(path), joint_order, member)


def motion_file(
    path: Path,
    content: bytes,
    joint_order: JointOrder | None = None,
    member: str | None = None,
) -> CsvFile | ArrayFile:
    """A motion file from its bytes; see `open_motion_file`.

    Args:
        path: names it.
        content: its bytes.
        joint_order: of the joints, where it does not name them.
        member: the name of the motion, in a file of several.

    Raises:
        MotionError: it is empty, of another format, or has no such motion.
    """
    if is_array_file(content):
        return ArrayFile(path, content, joint_order, member)
    if member is not None:
        raise MotionError(f"{path.name} is not a file of several motions.", f"Give {path} alone.")
    for start, kind in _NOT_READ.items():
        if content.startswith(start):
            raise MotionError(f"{path.name} looks like {kind}, which is not read.", _READ)
    if content and path.suffix.lower() in _BINARY:
        raise MotionError(f"{path.name} does not begin as a file of its name does.", _READ)
    return CsvFile(path, content, joint_order)


def _of_member(path: Path) -> tuple[Path, str | None]:
    """The file, and the name of a motion in it where the path is that of no file."""
    text = str(path)
    with suppress(OSError):  # a name that is too long
        for at in (i for i, character in enumerate(text) if character == ":"):
            if Path(text[:at]).is_file() and not path.exists():
                return Path(text[:at]), text[at + 1 :]
    return path, None


def _read(path: Path) -> bytes:
    try:
        return read_file(path, MOTION_FILE)
    except IsADirectoryError:
        raise MotionError(
            f"{path} is a directory, and no bag or session: it has no metadata.yaml.",
            "Give a motion file in it.",
        ) from None
    except FileNotFoundError:
        raise MotionError(
            f"There is no motion file {path}.",
            "Give the path of a motion file or of a session file, or the name of a bundled motion: "
            f"{', '.join(BUNDLED_MOTIONS)}.",
        ) from None
    except OSError as error:
        raise MotionError(
            f"The motion file {path} cannot be read: {error.strerror}.",
            "Give the path of a file that you may read; save what comes from a pipe first.",
        ) from None
