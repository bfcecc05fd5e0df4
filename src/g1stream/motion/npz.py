"""Motions in NPZ: the arrays that `Motion.save` writes, and the arrays of any NPZ or NPY.

Nothing of a file is executed, and its size is limited before it is unpacked.
"""

from __future__ import annotations

import io
import warnings
import zipfile
import zlib
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.input_limits import NUMBER, UNPACKED
from g1stream.motion.readers import Evidence, Poses
from g1stream.robot.joints import JOINT_NAMES, N_JOINTS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from g1stream.motion.motion import Motion
    from g1stream.motion.readers import MotionFile

__all__ = ["open_npz", "read_npy", "unzip", "write_npz"]

#: The arrays that `Motion.save` writes.
_OWN: Final = ("joint_names", "joint_pos", "root_pos", "root_quat_wxyz", "fps")


def open_npz(file: MotionFile) -> Poses | None:
    """Open an NPZ with the arrays that `Motion.save` writes; None if its arrays are others.

    Raises:
        MotionError: it is damaged, larger than 512 MiB unpacked, or a number is not finite.
    """
    try:
        contents = unzip(file.content, {f"{name}.npy" for name in _OWN})
        if not contents:
            return None
        read: dict[str, Any] = {name: read_npy(contents[f"{name}.npy"]) for name in _OWN}
    except ValueError as error:
        raise MotionError(f"{file.path.name}: {error}.", "Give a whole NPZ file.") from error
    if not _is_own(read):
        return None
    names, joint_pos, root_pos, quat, fps = read.values()
    for name, values in zip(_OWN[1:4], (joint_pos, root_pos, quat), strict=True):
        if not (values.min() >= -NUMBER and values.max() <= NUMBER):  # False for NaN
            raise MotionError(
                f"{file.path.name}: {name} has a number that is not finite, or beyond {NUMBER:g}.",
                "Correct it.",
            )
    columns = [names.tolist().index(name) for name in JOINT_NAMES]
    shown = [*read] if file.fps is None else [*read][:-1]
    used = {"file": f"NPZ with {', '.join(shown)}", "joint order": "named by the file"}
    used["pelvis"] = "root_pos, root_quat_wxyz, wxyz"
    poses = joint_pos[:, columns], root_pos, quat
    return Poses(file, Evidence(used), *poses, fps=float(fps))


def _is_own(arrays: dict[str, Any]) -> bool:
    """Whether arrays have the types, shapes and joints that `Motion.save` writes."""
    names, *numbers = arrays.values()
    if any(isinstance(one, bytes) or one.dtype != float for one in numbers):
        return False
    n_frames = len(np.atleast_1d(numbers[0]))
    shapes = [(n_frames, width) for width in (N_JOINTS, 3, 4)]
    named = not isinstance(names, bytes) and names.shape == (N_JOINTS,)
    return (
        named
        and set(names.tolist()) == set(JOINT_NAMES)
        and [one.shape for one in numbers] == [*shapes, ()]
        and n_frames > 0
        and bool(numbers[-1] > 0)
    )


def write_npz(motion: Motion, path: Path) -> None:
    """Write the arrays of `Motion`, in double precision."""
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            fps=motion.fps,
            joint_names=np.array(motion.joint_names),
            joint_pos=motion.joint_pos,
            root_pos=motion.root_pos,
            root_quat_wxyz=motion.root_quat_wxyz,
        )


def unzip(data: bytes, only: set[str] | None = None) -> dict[str, bytes]:
    """The files in a ZIP, by name; empty if `only` is given, and their names are others.

    Raises:
        ValueError: it is damaged, or larger than 512 MiB unpacked.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if only and {member.filename for member in members} != only:
                return {}
            # zipfile itself reads at most this size of a member.
            if sum(member.file_size for member in members) > UNPACKED:
                raise ValueError(f"it is larger than {UNPACKED / 2**20:g} MiB unpacked")
            plain = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
            if any(member.compress_type not in plain for member in members):
                raise ValueError("it has a compression other than deflate")
            return {member.filename: archive.read(member) for member in members}
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ValueError("it is damaged or incomplete") from error
    except (NotImplementedError, RuntimeError) as error:  # encrypted, or a newer ZIP version
        raise ValueError(str(error)) from error


def read_npy(data: bytes) -> NDArray[Any] | bytes:
    """The array in an NPY file, or their pickle if its values are Python objects.

    Raises:
        ValueError: it is damaged.
    """
    file = io.BytesIO(data)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("an array has another NPY version than 1.0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numpy warns about headers written by Python 2
        try:
            shape, column_major, dtype = np.lib.format.read_array_header_1_0(file)
        except Exception as error:  # numpy evaluates the header as Python, with many errors
            raise ValueError("the header of an array is damaged") from error
    if dtype.hasobject:
        return data[file.tell() :]
    try:
        values = np.frombuffer(data, dtype, offset=file.tell())
        return values.reshape(shape, order="F" if column_major else "C")
    except ValueError as error:
        raise ValueError("an array is damaged or incomplete") from error
