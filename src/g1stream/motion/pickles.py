"""Arrays in plain containers from pickles and files of PyTorch; nothing in them is run.

Numbers, texts, lists, tuples, dicts, arrays and tensors are read. What these are made with has
stand-ins here, and anything else is left out as `Unread`. numpy's own functions are not called:
they would allocate whatever a file claims.
"""

from __future__ import annotations

import io
import pickle
import re
import zlib
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.input_limits import PICKLE_VALUES, UNPACKED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

__all__ = ["Unread", "read_pickle", "read_torch"]

#: How deep arrays are in containers; bytes that a value in one, or a kind of object, counts as.
_DEPTH: Final = 4
_VALUE: Final = UNPACKED // PICKLE_VALUES
_KIND: Final = UNPACKED // 1000
#: The types of numbers and texts that arrays may have; texts may be Python objects.
_DTYPE: Final = re.compile(r"[<>|=]?([biufSU][0-9]{1,5}|O8?)")
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


@dataclass(frozen=True)
class Unread:
    """Stands for a value of another kind, such as an enum; `name` is that of its class."""

    name: str


def read_pickle(data: bytes) -> Any:
    """What is in a pickle or a file of joblib, plain or compressed with zlib or gzip.

    Raises:
        ValueError: it is damaged or larger than 512 MiB unpacked.
    """
    if data[:1] != pickle.PROTO:
        decompressor = zlib.decompressobj(wbits=zlib.MAX_WBITS + 32)  # zlib or gzip
        try:
            data = decompressor.decompress(data, UNPACKED)
        except zlib.error as error:
            raise ValueError(f"it cannot be unpacked: {error}") from error
        if decompressor.unconsumed_tail:
            raise _too_large()
    return _Unpickler(data).content()


def read_torch(members: Mapping[str, bytes]) -> Any:
    """What is in a file of `torch.save`, tensors as arrays. PyTorch is not needed.

    Args:
        members: the files in its ZIP, by name: a pickle, `data.pkl`, and numbers for each storage.

    Raises:
        ValueError: as `read_pickle`.
    """
    name = next(name for name in members if name.endswith("/data.pkl"))
    place = name.removesuffix("data.pkl")
    if members.get(f"{place}byteorder", b"little") != b"little":
        raise ValueError("its tensors are big-endian")
    numbers = {key.removeprefix(f"{place}data/"): data for key, data in members.items()}
    return _Unpickler(members[name], numbers).content()


def _too_large() -> ValueError:
    return ValueError(f"it is larger than {UNPACKED / 2**20:g} MiB unpacked")


class _Unpickler(pickle.Unpickler):
    """Finds the stand-ins alone.

    Args:
        data: of the pickle.
        numbers: those of each storage of PyTorch, by its key.
    """

    def __init__(self, data: bytes, numbers: Mapping[str, bytes] | None = None) -> None:
        self.file = io.BytesIO(data)
        super().__init__(self.file)
        self._numbers, self._left = numbers or {}, UNPACKED
        self._classes: dict[tuple[str, str], type[_StandIn]] = {}

    def content(self) -> Any:
        try:
            return self._plain(self.load())
        except ValueError:
            raise
        except Exception as error:  # a damaged pickle raises whatever its last operation raises
            raise ValueError(f"it is a damaged pickle: {error!r:.80}") from error

    def find_class(self, module: str, name: str) -> Any:
        key = module.replace("._core.", ".core."), name
        if key not in self._classes:
            self.charge(_KIND)
            stand_in = _Storage if module == "torch" and name in _STORAGES else _Other
            # Classes of its own, as a pickle may set attributes of what it finds.
            members = {"source": self, "full_name": f"{module}.{name}"}
            self._classes[key] = type(name, (_STAND_INS.get(key, stand_in),), members)
        return self._classes[key]

    def persistent_load(self, pid: Any) -> NDArray[Any]:
        """A storage."""
        _, kind, key, *_ = pid
        return np.frombuffer(self._numbers[key], _STORAGES[kind.__name__])

    def charge(self, size: int) -> None:
        """Count bytes that are made: a small pickle may ask for the same ones again and again."""
        self._left -= size
        if self._left < 0:
            raise _too_large()

    def _plain(self, value: Any, depth: int = 0) -> Any:
        """Arrays in the place of what stands for them, down to lists in a dict of dicts."""
        self.charge(_VALUE)
        if isinstance(value, _Array):
            return value.values
        if isinstance(value, _Other):
            return Unread(value.full_name)
        if depth < _DEPTH and isinstance(value, dict):
            return {str(name): self._plain(one, depth + 1) for name, one in value.items()}
        if depth < _DEPTH and isinstance(value, (list, tuple)):
            return [self._plain(one, depth + 1) for one in value]
        plain = value is None or isinstance(value, (bool, int, float, str, bytes))
        return value if plain else Unread(type(value).__name__)


class _StandIn:
    """Stands for a class or a function that a pickle names; `source` is the unpickler."""

    source: _Unpickler
    full_name: str

    def __init__(self, *_: Any) -> None: ...


class _Dtype(_StandIn):
    def __init__(self, name: str = "", *_: Any) -> None:
        if not isinstance(name, str) or not _DTYPE.fullmatch(name):
            raise ValueError(f"it has an array of the type {name!r:.40}")
        self.numpy = np.dtype(name)

    def __setstate__(self, state: Any) -> None:
        if state[1] in (">", "<"):
            self.numpy = self.numpy.newbyteorder(state[1])


class _Array(_StandIn):
    """An array, empty until its content is known; a list where it has texts as Python objects."""

    values: Any = np.empty(0)

    def __setstate__(self, state: Any) -> None:
        _, shape, dtype, column_major, content = state
        self._fill(content, dtype, shape, "F" if column_major else "C")

    def _fill(self, content: Any, dtype: _Dtype, shape: Any, order: Any) -> None:
        if not dtype.numpy.hasobject:
            values = np.frombuffer(content, dtype.numpy)
            self.values = values.reshape(tuple(shape), order="F" if order == "F" else "C")
        elif isinstance(content, list) and all(isinstance(one, str) for one in content):
            self.values = content
        else:
            raise ValueError("it has an array of Python objects")


class _ArrayOfBuffer(_Array):
    def __init__(self, content: Any, dtype: _Dtype, shape: Any, order: Any) -> None:
        self._fill(content, dtype, shape, order)


class _JoblibArray(_Array):
    """An array that joblib has written behind the description of it."""

    def __setstate__(self, state: Any) -> None:
        shape, dtype, file = state["shape"], state["dtype"], self.source.file
        if state.get("numpy_array_alignment_bytes") is not None:
            file.read(file.read(1)[0])
        content = file.read(prod(int(n) for n in shape) * dtype.numpy.itemsize)
        self._fill(content, dtype, shape, state["order"])


class _Tensor(_Array):
    """Numbers of a storage from an offset on; strides are in numbers."""

    def __init__(
        self, storage: NDArray[Any], offset: int, shape: Any, strides: Any, *_: Any
    ) -> None:
        shape, strides = tuple(map(int, shape)), tuple(map(int, strides))
        last = offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
        if offset < 0 or min((*shape, *strides, 0)) < 0 or (prod(shape) and last >= len(storage)):
            raise ValueError("it has a tensor beyond its storage")
        if prod(shape) > max(len(storage), 1):  # steps of zero repeat numbers without end
            raise ValueError("it has a tensor that is larger than its storage")
        steps = [stride * storage.itemsize for stride in strides]
        self.values = np.lib.stride_tricks.as_strided(storage[offset:], shape, steps)


class _Storage(_StandIn):
    """The type of a storage of PyTorch."""


class _Other(_StandIn):
    """What is not read; nothing of it is run."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def _ignore(self, *_: Any) -> None: ...

    append = extend = add = __setitem__ = __setstate__ = _ignore


class _Scalar(_StandIn):
    def __new__(cls, dtype: _Dtype, content: bytes) -> Any:
        cls.source.charge(dtype.numpy.itemsize)
        return np.frombuffer(content, dtype.numpy, count=1)[0].item()


class _Encoded(_StandIn):
    """Bytes as protocol 2 writes them."""

    def __new__(cls, text: str, _encoding: str) -> Any:
        cls.source.charge(len(text))
        return text.encode("latin1")


class _Dict(_StandIn):
    def __new__(cls) -> Any:
        return {}


_STAND_INS: Final[Mapping[tuple[str, str], type[_StandIn]]] = {
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Dtype,
    ("numpy.core.multiarray", "_reconstruct"): _Array,
    ("numpy.core.multiarray", "scalar"): _Scalar,
    ("numpy.core.numeric", "_frombuffer"): _ArrayOfBuffer,
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
    ("collections", "OrderedDict"): _Dict,
    ("_codecs", "encode"): _Encoded,
    ("torch._utils", "_rebuild_tensor_v2"): _Tensor,
}
