"""Motion files: detection of the format, its reader, and the evidence about the file.

`FORMATS` has the formats of the core. It is asked first, then the table of the extra `formats`.
"""

from __future__ import annotations

import hashlib
import re
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import numpy as np

from g1stream.errors import ConfigError, MotionError
from g1stream.files import begins_with, is_session, read_file
from g1stream.input_limits import CSV_LINE, MOTION_FILE
from g1stream.motion.motion import DEFAULT_FPS, SMALLEST_QUAT, Motion, check_fps, norm_warning
from g1stream.optional import EXTENSIONS, extension, load_object

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterator, Mapping

    from g1stream.config import Config
    from g1stream.robot.model import G1
    from g1stream.types import Floats, JointOrder

__all__ = [
    "ATTACH",
    "BUNDLED_MOTIONS",
    "FORMATS",
    "Evidence",
    "Format",
    "MotionFile",
    "MotionReader",
    "Poses",
    "default_motion",
    "find_motion",
    "load_motion",
]

BUNDLED_MOTIONS: Final = ("demo",)
"""Names of the motions in this package."""

ATTACH: Final = (
    "A recording of a robot is no motion: `g1stream attach RECORDING MOTION` finds when one was "
    "played in it."
)
"""Remedy for a recording that another program made."""
#: The start of a file that Git LFS has replaced by a pointer.
_LFS: Final = b"version https://git-lfs"
#: Bytes that the header of our tables does not have.
_NO_TEXT: Final = re.compile(rb"[^\t\r -~]")
#: A frame rate in a file name.
_RATE: Final = re.compile(r"(\d+(?:\.\d+)?)[ _-]?(?:hz|fps)", re.IGNORECASE)


@dataclass(frozen=True)
class Evidence:
    """The content of a file, and its interpretation.

    Attributes:
        used: by subject, such as `joint order`: the interpretation, and its source in the file.
        assumed: by subject: assumptions about what the file does not specify.
        not_used: unused joints, columns and arrays of the file.
        missing: joints that the file lacks; they stay at 0.
        usual: the layout is that of LAFAN1, without or with a header, for which the assumptions are
            right; no warning names them.
    """

    used: Mapping[str, str]
    assumed: Mapping[str, str] = field(default_factory=dict)
    not_used: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    usual: bool = False

    @property
    def assumptions(self) -> dict[str, str]:
        """By subject: what is assumed, as text for a user."""
        return {subject: f"{text}, assumed" for subject, text in self.assumed.items()}


class MotionReader(Protocol):
    """An open motion file. Its constructor takes a `MotionFile`, and may raise.

    Both members raise MotionError, or RecordingError for a recording, if the file is wrong.
    """

    @property
    def evidence(self) -> Evidence:
        """The content of the file, and its interpretation."""

    def motion(self) -> Motion:
        """The motion, its joints in motor order."""


@dataclass(frozen=True)
class MotionFile:
    """A file, and the options for reading it.

    Attributes:
        path: its path, also for messages.
        fps: frames per second; the file's if None.
        joint_order: joint order if the file does not name joints; detected by evidence if None.
        member: name of the motion, in a file of several.
        robot: robot that plays it. No warning names joints that both the file and it lack.
        data: the content, if it is not at the path.
    """

    path: Path
    fps: float | None = None
    joint_order: JointOrder | None = None
    member: str | None = None
    robot: G1 | None = None
    data: bytes | None = None

    @cached_property
    def content(self) -> bytes:
        """The whole content.

        Raises:
            MotionError: it cannot be read, or is a pointer of Git LFS.
        """
        if self.data is not None:
            return self.data
        try:
            content = read_file(self.path, MOTION_FILE)
        except IsADirectoryError:
            raise MotionError(
                f"{self.path} is a directory without metadata.yaml: neither a bag nor a session.",
                "Give a motion file in the directory.",
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
                "Give the path of a readable file; save data from a pipe to a file first.",
            ) from None
        if content.startswith(_LFS):
            raise MotionError(
                f"{self.path.name} is a pointer of Git LFS, not the file itself.",
                "Fetch it: git lfs pull.",
            )
        return content

    @property
    def sha256(self) -> str:
        """SHA-256 of the content, in hex."""
        return hashlib.sha256(self.content).hexdigest()

    def open(self) -> MotionReader:
        """Open the file with the reader of its format.

        Raises:
            MotionError: it cannot be read, is empty, or has no supported format.
            RecordingError: it is a damaged recording.
            ConfigError: the extra that reads it needs a package.
        """
        if self.fps is not None:
            check_fps(self.fps, self.path.stem)
        if reader := self._opened(FORMATS):
            return reader
        without = ""
        try:
            foreign: tuple[Format, ...] = extension("motion_formats")
        except ConfigError:
            foreign, without = (), " without the extra `formats`"
        if reader := self._opened(foreign):
            return reader
        if not self.content:
            raise MotionError(
                f"{self.path.name}: the file is empty.", "Give a motion or a session."
            )
        names = dict.fromkeys(one.name for one in FORMATS + foreign)
        raise MotionError(
            f"{self.path.name} has no supported format{without}.",
            f"Give a {', '.join(names)}: docs/formats.md says with which content.",
        )

    def _opened(self, formats: tuple[Format, ...]) -> MotionReader | None:
        """The reader of the first format that the file has."""
        for one in formats:
            if one.matches(self):
                if self.member is not None and not one.several:
                    raise MotionError(
                        f"{self.path.name} is not a file of several motions.",
                        f"Give {self.path} without a name.",
                    )
                reader: MotionReader | None = load_object(one.reader)(self)
                if reader:
                    return reader
        return None

    def load(self) -> Motion:
        """Read the motion; warnings name unusual assumptions, too. It raises what readers do."""
        reader, name = self.open(), f"{self.path.name}: "
        evidence, motion = reader.evidence, reader.motion()
        told = [text.removeprefix(name) for text in motion.warnings]
        assumed = tuple(
            f"{name}{subject}: {text}."
            for subject, text in evidence.assumptions.items()
            if not (evidence.usual or any(evidence.assumed[subject] in one for one in told))
        )
        return replace(motion, warnings=motion.warnings + assumed) if assumed else motion


@dataclass(frozen=True)
class Poses:
    """The poses in a motion file, with the joints in motor order. It is a `MotionReader`.

    Attributes:
        file: the file.
        told: the evidence; about the frame rate only if that is not in the file itself.
        joint_pos: (T, 29) rad.
        root_pos: (T, 3) position of the pelvis, m; None if the file has none.
        root_quat_wxyz: (T, 4), of any length above 0; None if the file has none.
        fps: frame rate in the file; None if it has none.
        warned: what was not used, filled in or corrected, a sentence each.
        first_line: line of frame 0 in a text.
    """

    file: MotionFile
    told: Evidence
    joint_pos: Floats
    root_pos: Floats | None
    root_quat_wxyz: Floats | None
    fps: float | None = None
    warned: tuple[str, ...] = ()
    first_line: int = 0

    @property
    def evidence(self) -> Evidence:
        """The evidence, with that about the frame rate."""
        used, assumed = dict(self.told.used), dict(self.told.assumed)
        if self.file.fps is None and self.fps:
            used.setdefault("frame rate", f"{self.fps:g} fps, from the file")
        elif self.file.fps is None:
            assumed["frame rate"] = f"{DEFAULT_FPS:g} fps"
        return replace(self.told, used=used, assumed=assumed)

    def motion(self) -> Motion:
        """The motion.

        Raises:
            MotionError: there is only one frame, a value is not finite, or a quaternion is zero.
        """
        file = self.file
        warned = (*self.warned, *self._rate_hint(), *self._norm_warnings())
        motion = Motion.from_arrays(
            self.joint_pos,
            self.root_pos,
            self.root_quat_wxyz,
            fps=file.fps or self.fps or DEFAULT_FPS,
            name=file.member or file.path.stem,
        )
        warnings = tuple(f"{file.path.name}: {text}" for text in warned)
        return replace(motion, source=file.path, sha256=file.sha256, warnings=warnings)

    def _rate_hint(self) -> Iterator[str]:
        hint = _RATE.search(self.file.member or self.file.path.stem)
        if hint and not (self.fps or self.file.fps) and float(hint[1]) != DEFAULT_FPS:
            yield (
                f"{DEFAULT_FPS:g} fps is assumed, because the file has no frame rate; its name has "
                f"{hint[0]}. Give --fps {hint[1]} if that is the rate."
            )

    def _norm_warnings(self) -> list[str]:
        if self.root_quat_wxyz is None:
            return []
        norms = np.linalg.norm(self.root_quat_wxyz, axis=1)
        worst = int(np.argmax(np.abs(norms - 1.0)))
        where = f"frame {worst}"
        if self.first_line:
            where += f", line {self.first_line + worst}"
        if norms.min() <= SMALLEST_QUAT:
            raise MotionError(
                f"{self.file.path.name}: the quaternion of {where} is zero.",
                "Give every frame an orientation; without rotation w is 1 and the others are 0.",
            )
        return norm_warning(norms, where)


class Format(NamedTuple):
    """A format of motion files.

    Attributes:
        name: its name, for messages.
        reader: makes a `MotionReader` from a `MotionFile`, or None if the file has another format:
            module and name, imported when a file matches.
        matches: whether a file may have this format, if no earlier format has it.
        several: files of this format may have several motions.
    """

    name: str
    reader: str
    matches: Callable[[MotionFile], bool]
    several: bool = False


def _is_recording(file: MotionFile) -> bool:
    return file.data is None and is_session(file.path)


def _is_bag(file: MotionFile) -> bool:
    """Whether a file is a bag in SQLite, or compressed as a whole."""
    starts = (b"SQLite format 3\0", b"\x28\xb5\x2f\xfd")
    return file.data is None and any(begins_with(file.path, start) for start in starts)


def _is_onnx(file: MotionFile) -> bool:
    return file.data is None and file.path.suffix.lower() == ".onnx"


def _is_one_motion(file: MotionFile) -> bool:
    """Whether a path is no directory, and is given without the name of a motion."""
    with suppress(OSError):  # for example, the name is too long
        return file.member is None and (file.data is not None or not file.path.is_dir())
    return False


def _is_npz(file: MotionFile) -> bool:
    return _is_one_motion(file) and file.content.startswith(b"PK")


def _is_csv(file: MotionFile) -> bool:
    """Whether the first line of a file is text with commas."""
    if not _is_one_motion(file):
        return False
    first = file.content[:CSV_LINE].split(b"\n", 1)[0]
    return b"," in first and not _NO_TEXT.search(first.removeprefix(b"\xef\xbb\xbf"))


FORMATS: Final = (
    Format("session or MCAP", "g1stream.session.motions:open_played", _is_recording),
    Format("bag of ROS 2", EXTENSIONS["read_bag"], _is_bag),
    Format("policy that holds its motion (ONNX)", EXTENSIONS["read_policy"], _is_onnx),
    Format("NPZ", "g1stream.motion.npz:open_npz", _is_npz),
    Format("CSV", "g1stream.motion.csv:open_csv", _is_csv),
)
"""The formats that the core reads."""


def default_motion(config: Config, otherwise: str | None = None) -> str:
    """The motion that plays if none is given: the policy's own, or `otherwise`.

    Raises:
        ConfigError: the policy cannot be read, or there is neither.
    """
    policy = config.stream.policy
    motion: str | None = (policy and extension("motion_in_policy")(policy)) or otherwise
    if motion is None:
        raise ConfigError(
            "No motion is given.", "Give a motion file, or a policy that holds its motion."
        )
    return motion


def find_motion(
    path_or_name: str | os.PathLike[str],
    *,
    fps: float | None = None,
    joint_order: JointOrder | None = None,
    robot: G1 | None = None,
) -> MotionFile:
    """Find a motion file; the arguments are those of `load_motion`."""
    path, member = Path(path_or_name), None
    if path_or_name in BUNDLED_MOTIONS:
        path = Path(str(resources.files("g1stream.motion") / f"{path_or_name}.csv"))
        fps = DEFAULT_FPS if fps is None else fps  # known, not assumed
    text = str(path)
    with suppress(OSError):  # for example, the name is too long
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
        path_or_name: a file in a format of docs/formats.md, followed by `:NAME` for a motion in a
            file of several; a session file, whose reference is the motion; a bag with joint states;
            or the name of a bundled motion.
        fps: frames per second. If None, the file's, or 30 if it has none (a CSV never has one).
            A session is sampled at this rate, by default the rate of its reference.
        joint_order: joint order if the file does not name joints. If None, bodies and joint limits
            decide; if both orders fit, a CSV file is in motor order. `motor-23dof` is for columns
            of the joints of g1_23dof.
        robot: robot that plays it. No warning names joints that both the file and it lack. If 23
            columns fit its joints as well as others, they are its joints.

    Returns:
        The motion, with its joints in motor order and unit quaternions. `Motion.warnings` lists
        what was assumed, not used, filled in or corrected.

    Raises:
        MotionError: there is no such file, its content is wrong, or the joint order is ambiguous.
        RecordingError: the session is damaged, or no motion was played in it.
        ConfigError: the extra that reads it is not installed.
    """
    return find_motion(path_or_name, fps=fps, joint_order=joint_order, robot=robot).load()
