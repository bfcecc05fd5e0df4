"""Motion files: what reads each format, and what a file turns out to have.

A format is one file with its reader, and one row of `FORMATS`.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from g1stream.errors import MotionError
from g1stream.files import begins_with, is_session, read_file
from g1stream.input_limits import CSV_LINE, MOTION_FILE
from g1stream.motion.motion import Motion, check_fps
from g1stream.optional import EXTENSIONS, load_object

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping

    from g1stream.robot.model import G1
    from g1stream.types import JointOrder

__all__ = [
    "BUNDLED_MOTIONS",
    "Evidence",
    "MotionFile",
    "MotionReader",
    "find_motion",
    "is_sonic",
    "load_motion",
]

BUNDLED_MOTIONS: Final = ("demo",)
"""Names of the motions in this package."""

#: How a file begins that Git LFS has left in the place of another.
_LFS: Final = b"version https://git-lfs"
#: Files that zlib or gzip has compressed.
_COMPRESSED: Final = (b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda", b"\x1f\x8b")
_ARRAYS: Final = "g1stream.motion.arrays:open_arrays"


@dataclass(frozen=True)
class Evidence:
    """What a file has, and what it was taken for.

    Attributes:
        used: by subject, such as `joint order`, what in the file says it, and why.
        assumed: by subject, what was taken where the file does not say it.
        not_used: joints, columns and arrays of the file that are left out.
        missing: joints that the file lacks, and that stay at 0.
    """

    used: Mapping[str, str]
    assumed: Mapping[str, str] = field(default_factory=dict)
    not_used: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()


class MotionReader(Protocol):
    """A motion file that is open. It is made from a `MotionFile`, and may refuse it.

    Both members raise MotionError, or RecordingError if it is a recording, where the file is wrong.
    """

    @property
    def evidence(self) -> Evidence:
        """What the file has."""

    def motion(self) -> Motion:
        """The motion, its joints in motor order."""


@dataclass(frozen=True)
class MotionFile:
    """A file, and how it is to be read.

    Attributes:
        path: where it is, for messages.
        fps: frames per second; what the file says if None.
        joint_order: of the joints, where the file does not name them; told by evidence if None.
        member: the name of the motion, in a file of several.
        robot: that plays it; where it has fewer joints, too, no warning names those in the file.
        data: its content, where that is not at the path.
    """

    path: Path
    fps: float | None = None
    joint_order: JointOrder | None = None
    member: str | None = None
    robot: G1 | None = None
    data: bytes | None = None

    @cached_property
    def content(self) -> bytes:
        """All of it.

        Raises:
            MotionError: it cannot be read, or is a pointer of Git LFS.
        """
        if self.data is not None:
            return self.data
        try:
            content = read_file(self.path, MOTION_FILE)
        except IsADirectoryError:
            raise MotionError(
                f"{self.path} is a directory, and no bag or session: it has no metadata.yaml.",
                "Give a motion file in it.",
            ) from None
        except FileNotFoundError:
            raise MotionError(
                f"There is no motion file {self.path}.",
                "Give the path of a motion file or of a session file, or the name of a bundled "
                f"motion: {', '.join(BUNDLED_MOTIONS)}.",
            ) from None
        except OSError as error:
            raise MotionError(
                f"The motion file {self.path} cannot be read: {error.strerror}.",
                "Give the path of a file that you may read; save what comes from a pipe first.",
            ) from None
        if content.startswith(_LFS):
            raise MotionError(
                f"{self.path.name} is a pointer of Git LFS, not the file itself.",
                "Fetch it: git lfs pull.",
            )
        return content

    @property
    def sha256(self) -> str:
        """Of the content, in hex."""
        return hashlib.sha256(self.content).hexdigest()

    def open(self) -> MotionReader:
        """The reader of its format.

        Raises:
            MotionError: it cannot be read, is empty, or of no format that is read.
            RecordingError: it is a damaged recording.
            ConfigError: an extra that reads it is not installed.
        """
        if self.fps is not None:
            check_fps(self.fps, self.path.stem)
        for one in FORMATS:
            if one.matches(self):
                if self.member is not None and not one.several:
                    raise MotionError(
                        f"{self.path.name} is not a file of several motions.",
                        f"Give {self.path} alone.",
                    )
                reader: MotionReader = load_object(one.reader)(self)
                return reader
        raise MotionError(
            f"{self.path.name} is in no format that is read.",
            f"Give a {', '.join(one.name for one in FORMATS)}: docs/formats.md says with which "
            "content.",
        )


class Format(NamedTuple):
    """A format of motion files.

    Attributes:
        name: of it, for messages.
        reader: what makes a `MotionReader` of a `MotionFile`: a module and a name in it, which is
            imported when a file has this format.
        matches: whether a file has this format, if it has none of those before.
        several: a file has several motions, or may have.
    """

    name: str
    reader: str
    matches: Callable[[MotionFile], bool]
    several: bool = False


def _begins(*starts: bytes) -> Callable[[MotionFile], bool]:
    return lambda file: file.content.startswith(starts)


def _is_recording(file: MotionFile) -> bool:
    return file.data is None and is_session(file.path)


def _is_bag(file: MotionFile) -> bool:
    """Whether it is one in SQLite, or compressed as a whole."""
    starts = (b"SQLite format 3\0", b"\x28\xb5\x2f\xfd")
    return file.data is None and any(begins_with(file.path, start) for start in starts)


def is_sonic(path: Path) -> bool:
    """Whether it is a directory with the tables of SONIC; False if it cannot be read."""
    try:
        return (path / "joint_pos.csv").is_file()
    except OSError:  # a name that is too long
        return False


def _is_onnx(file: MotionFile) -> bool:
    return file.data is None and file.path.suffix.lower() == ".onnx"


def _is_table(file: MotionFile) -> bool:
    """Whether it says that it is a table, or its first line looks like one; an empty file is."""
    named = file.path.suffix.lower() in (".csv", ".txt")
    first = file.content[:CSV_LINE].split(b"\n", 1)[0]
    return named or b"," in first or not first


FORMATS: Final = (
    Format("session or MCAP", "g1stream.session.motions:open_played", _is_recording),
    Format("bag of ROS 2", EXTENSIONS["read_bag"], _is_bag),
    Format(
        "directory of SONIC",
        "g1stream.motion.arrays:open_sonic",
        lambda file: file.data is None and is_sonic(file.path),
    ),
    Format("NPZ, file of PyTorch", _ARRAYS, _begins(b"PK"), several=True),
    Format("NPY", _ARRAYS, _begins(b"\x93NUMPY")),
    Format("pickle", _ARRAYS, _begins(b"\x80", *_COMPRESSED), several=True),
    Format("policy that holds its motion (ONNX)", EXTENSIONS["read_policy"], _is_onnx),
    Format("CSV", "g1stream.motion.arrays:open_table", _is_table),
)
"""The formats that are read."""


def find_motion(
    path_or_name: str | os.PathLike[str],
    *,
    fps: float | None = None,
    joint_order: JointOrder | None = None,
    robot: G1 | None = None,
) -> MotionFile:
    """A motion file; arguments are those of `load_motion`."""
    path, member = Path(path_or_name), None
    if path_or_name in BUNDLED_MOTIONS:
        path = Path(str(resources.files("g1stream.motion") / f"{path_or_name}.csv"))
    text = str(path)
    with suppress(OSError):  # a name that is too long
        for at in (i for i, character in enumerate(text) if character == ":"):
            if Path(text[:at]).is_file() and not path.exists():
                path, member = Path(text[:at]), text[at + 1 :]
                break
    return MotionFile(path, fps, joint_order, member, robot)


def load_motion(
    path_or_name: str | os.PathLike[str],
    *,
    fps: float | None = None,
    joint_order: JointOrder | None = None,
    robot: G1 | None = None,
) -> Motion:
    """Read a motion file, a session, a bag, or a bundled motion by its name (`demo`).

    Args:
        path_or_name: a file of one of the formats in docs/formats.md, followed by `:NAME` for a
            motion in a file of several; a session file, whose motion is the reference that was
            played; a bag with joint states; or the name of a bundled motion.
        fps: frames per second; what the file says if None, or 30 where it does not, as a CSV file
            cannot. A session is sampled at it, at the rate of its reference if None.
        joint_order: of the joints where a file does not name them. If None, bodies and joint limits
            decide; where they leave a choice, a CSV file is taken to be in motor order.
        robot: that plays it; no warning says that the file lacks joints that the robot lacks, too.

    Returns:
        The motion, its joints in motor order whatever the order in the file, its quaternions unit.
        `Motion.warnings` say what is not used, filled in or corrected.

    Raises:
        MotionError: there is no such file, something in it is wrong, or the order of the joints
            cannot be told.
        RecordingError: the session is damaged, or no motion was played in it.
        ConfigError: an extra that reads it is not installed.
    """
    file = find_motion(path_or_name, fps=fps, joint_order=joint_order, robot=robot)
    return file.open().motion()
