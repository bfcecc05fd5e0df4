"""Files of named arrays: NPZ, NPY, pickles and files of PyTorch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from g1stream.errors import MotionError
from g1stream.extras.formats.evidence import READ, members, poses_of
from g1stream.extras.formats.pickles import read_pickle, read_torch
from g1stream.motion.npz import read_npy, unzip

if TYPE_CHECKING:
    from g1stream.motion.readers import MotionFile, Poses

__all__ = ["motions_in", "open_arrays", "read_arrays"]


def open_arrays(file: MotionFile) -> Poses:
    """Open an NPZ, an NPY, a PyTorch file, or a pickle, plain or from joblib.

    Raises:
        MotionError: it cannot be read, or has no such motion.
    """
    return poses_of(file, *_content(file))


def motions_in(file: MotionFile) -> tuple[str, ...]:
    """Names of the motions in a pickle or PyTorch file; empty if it has only one motion.

    Raises:
        MotionError: it cannot be read.
    """
    return members(_content(file)[1])


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
