"""Files of named arrays: NPZ, NPY, pickles and files of PyTorch."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from g1stream.errors import MotionError
from g1stream.extras.formats.evidence import BESIDE, READ, poses_of
from g1stream.extras.formats.pickles import read_pickle, read_torch
from g1stream.files import read_file
from g1stream.input_limits import SETTINGS_FILE, check_integers
from g1stream.motion.npz import read_npy, unzip
from g1stream.text import listed

if TYPE_CHECKING:
    from g1stream.motion.readers import MotionFile, Poses

#: What is used of the file beside an NPZ.
_BESIDE: Final = ("fps", "joint_names", "body_names")

__all__ = ["motions_in", "open_arrays", "read_arrays"]


def open_arrays(file: MotionFile) -> Poses:
    """Open an NPZ, an NPY, a PyTorch file, or a pickle, plain or from joblib.

    Raises:
        MotionError: it cannot be read, or has no such motion.
    """
    kind, content = _content(file)
    return poses_of(file, kind, _one_motion(file, content), beside=_beside(file))


def _beside(file: MotionFile) -> dict[str, Any]:
    """The frame rate, and the names of joints and bodies, in `meta.json` beside the file."""
    if file.data is not None or file.path.suffix.lower() != ".npz":
        return {}
    with suppress(OSError, ValueError, RecursionError):
        content = json.loads(read_file(file.path.parent / BESIDE, SETTINGS_FILE))
        check_integers(content)
        if isinstance(content, dict):
            return {name: content[name] for name in _BESIDE if name in content}
    return {}


def _one_motion(file: MotionFile, content: Any) -> dict[str, Any]:
    """The arrays of the file, or of the selected or only motion in a dict of motions."""
    member, name = file.member, file.path.name
    if not isinstance(content, dict) or not content:
        raise MotionError(f"{name}: it has no named arrays.", READ)
    names = _members(content)
    if not names:
        if member is None:
            return content
        raise MotionError(
            f"{name}: it is one motion without the name {member}.", "Remove the name."
        )
    if member is None and len(names) == 1:
        (member,) = names
    if member not in names:
        count = f"{len(names)} motions" if len(names) > 1 else "one motion"
        has = f"it has {count}" + (f", and none with the name {member}" if member else "")
        raise MotionError(
            f"{name}: {has}: {listed(names)}.", f"Give one by its name: {file.path}:{names[0]}"
        )
    arrays: dict[str, Any] = content[member]
    return arrays


def motions_in(file: MotionFile) -> tuple[str, ...]:
    """Names of the motions in a pickle or PyTorch file; empty if it has only one motion.

    Raises:
        MotionError: it cannot be read.
    """
    return _members(_content(file)[1])


def _members(content: Any) -> tuple[str, ...]:
    """Names of the motions in a dict of motions; empty if it is one motion."""
    if isinstance(content, dict) and all(isinstance(one, dict) for one in content.values()):
        return tuple(content)
    return ()


def _content(file: MotionFile) -> tuple[str, Any]:
    """Kind and content of a file, as `read_arrays` returns them.

    Raises:
        MotionError: it cannot be read.
    """
    try:
        return read_arrays(file.content)
    except ValueError as error:
        raise MotionError(f"{file.path.name}: {error}.", READ) from error


def read_arrays(data: bytes) -> tuple[str, Any]:
    """Kind and content of a file. Nothing in it is executed.

    Raises:
        ValueError: it is damaged, or larger than 512 MiB unpacked.
    """
    if data.startswith(b"\x93NUMPY"):
        return "NPY", {"qpos": _npy(data)}
    if not data.startswith(b"PK"):
        return "pickle", read_pickle(data)
    members = unzip(data)
    if any(name.endswith("/data.pkl") for name in members):
        return "file of PyTorch", read_torch(members)
    return "NPZ", {name.removesuffix(".npy"): _npy(content) for name, content in members.items()}


def _npy(data: bytes) -> Any:
    """The array in an NPY file; an array of Python objects is read with `read_pickle`."""
    values = read_npy(data)
    return read_pickle(values) if isinstance(values, bytes) else values
