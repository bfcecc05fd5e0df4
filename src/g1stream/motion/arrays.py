"""Arrays from NPZ and NPY files, without running anything or trusting a claimed size."""

from __future__ import annotations

import io
import warnings
import zipfile
import zlib
from typing import Any

import numpy as np

from g1stream.input_limits import UNPACKED
from g1stream.motion.pickles import read_pickle

__all__ = ["is_npy", "is_zip", "read_npy", "read_npz", "zip_members"]


def is_zip(data: bytes) -> bool:
    """Whether content begins as that of an NPZ file does."""
    return data[:2] == b"PK"


def is_npy(data: bytes) -> bool:
    """Whether content begins as that of an NPY file, one array, does."""
    return data.startswith(b"\x93NUMPY")


def read_npz(data: bytes, *, objects: bool = False) -> dict[str, Any]:
    """The arrays of an NPZ file, by name.

    Args:
        data: content of the file.
        objects: also read arrays of Python objects, such as names, as `read_pickle` does.

    Raises:
        ValueError: it is larger than 512 MiB unpacked, or its content is not that of an NPZ.
    """
    return {
        name.removesuffix(".npy"): read_npy(content, objects=objects)
        for name, content in zip_members(data).items()
    }


def zip_members(data: bytes) -> dict[str, bytes]:
    """The files in a ZIP, by name."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            # zipfile itself reads no more than this size of a member.
            if sum(member.file_size for member in members) > UNPACKED:
                raise ValueError(f"it is larger than {UNPACKED / 2**20:g} MiB unpacked")
            plain = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
            if any(member.compress_type not in plain for member in members):
                raise ValueError("it is compressed in another way than deflate")
            return {member.filename: archive.read(member) for member in members}
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ValueError("it is damaged or cut off") from error
    except (NotImplementedError, RuntimeError) as error:  # encrypted, or of a newer ZIP
        raise ValueError(str(error)) from error


def read_npy(data: bytes, *, objects: bool = False) -> Any:
    """The array in an NPY file; see `read_npz`."""
    file = io.BytesIO(data)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("an array has another version than 1.0 of the NPY format")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of headers as Python 2 wrote them
        try:
            shape, column_major, dtype = np.lib.format.read_array_header_1_0(file)
        except Exception as error:  # numpy parses it as Python, which has many ways to fail
            raise ValueError("the header of an array is damaged") from error
    if dtype.hasobject:
        if not objects:
            raise ValueError("it has Python objects")
        return read_pickle(data[file.tell() :])
    try:
        values = np.frombuffer(data, dtype, offset=file.tell())
        return values.reshape(shape, order="F" if column_major else "C")
    except ValueError as error:
        raise ValueError("an array is damaged or cut off") from error
