"""Tensors from files of `torch.save` as arrays: PyTorch is neither needed nor called.

Such a file is a ZIP with a pickle, `data.pkl`, and beside it a file of numbers for each storage.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from math import prod
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from g1stream.motion.arrays import is_zip, zip_members
from g1stream.motion.pickles import ArrayStandIn, Unpickler

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

__all__ = ["is_torch", "read_torch"]


def is_torch(data: bytes) -> bool:
    """Whether content is that of a file of `torch.save`, a ZIP with a pickle of tensors in it."""
    if not is_zip(data):
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return any(name.endswith("/data.pkl") for name in archive.namelist())
    except (zipfile.BadZipFile, NotImplementedError, ValueError):
        return False


def read_torch(data: bytes) -> Any:
    """What is in a file of `torch.save`, tensors as arrays; all else as `read_pickle`.

    PyTorch is neither needed nor called.

    Raises:
        ValueError: there is something else in it, or it is damaged or larger than 512 MiB unpacked.
    """
    members = zip_members(data)
    name = next(name for name in members if name.endswith("/data.pkl"))
    place = name.removesuffix("data.pkl")
    if members.get(f"{place}byteorder", b"little") != b"little":
        raise ValueError("its tensors are big-endian")
    try:
        return _TensorUnpickler(members[name], members, f"{place}data/").load()
    except ValueError:
        raise
    except Exception as error:  # as in `read_pickle`
        raise ValueError(f"it is a damaged file of PyTorch: {error!r:.80}") from error


def _tensor(storage: NDArray[Any], offset: int, shape: Any, strides: Any, *_: Any) -> ArrayStandIn:
    """A tensor: the numbers of a storage from an offset on, with strides in numbers."""
    shape, strides = tuple(map(int, shape)), tuple(map(int, strides))
    last = offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
    if offset < 0 or min((*shape, *strides, 0)) < 0 or (prod(shape) and last >= len(storage)):
        raise ValueError("it has a tensor beyond its storage")
    if prod(shape) > max(len(storage), 1):  # steps of zero repeat numbers without end
        raise ValueError("it has a tensor that is larger than its storage")
    step = storage.itemsize
    array = ArrayStandIn()
    # A view: many tensors may share a storage.
    array.values = np.lib.stride_tricks.as_strided(
        storage[offset:], shape, [stride * step for stride in strides], writeable=False
    )
    return array


class _Storage:
    """Stands for the type of a storage of PyTorch, by the numpy name of its numbers."""

    def __init__(self, dtype: str) -> None:
        self.dtype = np.dtype(dtype)


_STORAGES: Final = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}


class _TensorUnpickler(Unpickler):
    """Reads tensors too.

    Args:
        data: of the pickle.
        members: the files in the ZIP, by name.
        place: where the storages are in it.
    """

    dispatch: ClassVar[dict[int, Any]] = {
        **Unpickler.dispatch,
        pickle.BINPERSID[0]: pickle._Unpickler.dispatch[pickle.BINPERSID[0]],
    }
    known: ClassVar = {**Unpickler.known, ("torch._utils", "_rebuild_tensor_v2"): _tensor}

    def __init__(self, data: bytes, members: Mapping[str, bytes], place: str) -> None:
        super().__init__(io.BytesIO(data))
        self._members, self._place = members, place

    def find_class(self, module: str, name: str) -> Any:
        if module == "torch" and name in _STORAGES:
            return _Storage(_STORAGES[name])
        return super().find_class(module, name)

    def persistent_load(self, pid: Any) -> Any:
        """A storage."""
        _, kind, key, *_ = pid
        if not isinstance(kind, _Storage):
            raise ValueError("it refers to what is not in it")
        return np.frombuffer(self._members[f"{self._place}{key}"], kind.dtype)
