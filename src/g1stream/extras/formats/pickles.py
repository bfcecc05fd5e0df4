"""Arrays in plain containers from pickles and PyTorch files. Nothing in them is executed.

Numbers, strings, lists, tuples, dicts, arrays and tensors are read. Their constructors are
replaced by the classes here; anything else becomes an `Unread`. numpy's own functions are not
called, because they would allocate whatever size a file claims.
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

from g1stream.input_limits import UNPACKED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

__all__ = ["Unread", "read_pickle", "read_torch"]

#: Numbers, texts and containers outside arrays; lists can contain a list repeatedly.
_VALUES: Final = 5_000_000
#: Deepest nesting of arrays in containers; bytes counted for a value in one or for a type.
_DEPTH: Final = 4
_VALUE: Final = UNPACKED // _VALUES
_KIND: Final = UNPACKED // 1000
#: The types of numbers and strings in arrays; strings may be Python objects.
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
    """A value of an unsupported type, such as an enum. `name` is the name of its class."""

    name: str


def read_pickle(data: bytes) -> Any:
    """The content of a pickle or a joblib file, plain or compressed with zlib or gzip.

    Raises:
        ValueError: it is damaged, or larger than 512 MiB unpacked.
    """
    if data[:1] != pickle.PROTO:
        decompressor = zlib.decompressobj(wbits=zlib.MAX_WBITS + 32)  # detects zlib and gzip
        try:
            data = decompressor.decompress(data, UNPACKED)
        except zlib.error as error:
            raise ValueError(f"it cannot be unpacked: {error}") from error
        if decompressor.unconsumed_tail:
            raise _too_large()
    return _Unpickler(data).content()


def read_torch(members: Mapping[str, bytes]) -> Any:
    """The content of a file of `torch.save`, with tensors as arrays, without PyTorch.

    Args:
        members: the files in its ZIP, by name: a pickle `data.pkl`, and a file per storage.

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
    """An unpickler that only finds the replacement classes.

    Args:
        data: the pickle.
        numbers: the data of each PyTorch storage, by its key.
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
        except MemoryError as error:  # a damaged length, or a large file
            raise ValueError("it is damaged, or needs more memory than there is") from error
        except Exception as error:  # any error that its last operation may raise
            raise ValueError(f"it is a damaged pickle: {error!r:.80}") from error

    def find_class(self, module: str, name: str) -> Any:
        key = module.replace("._core.", ".core."), name
        if key not in self._classes:
            self.charge(_KIND)
            stand_in = _Storage if module == "torch" and name in _STORAGES else _Other
            # New classes each time, because a pickle may set attributes on them.
            members = {"source": self, "full_name": f"{module}.{name}"}
            self._classes[key] = type(name, (_STAND_INS.get(key, stand_in),), members)
        return self._classes[key]

    def persistent_load(self, pid: Any) -> NDArray[Any]:
        """Return a storage by its id."""
        _, kind, key, *_ = pid
        return np.frombuffer(self._numbers[key], _STORAGES[kind.__name__])

    def charge(self, size: int) -> None:
        """Count allocated bytes, because a small pickle may request the same ones many times."""
        self._left -= size
        if self._left < 0:
            raise _too_large()

    def _plain(self, value: Any, depth: int = 0) -> Any:
        """Replace the stand-ins by arrays, in lists within a dict of dicts at most."""
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
    """Replaces a class or a function that a pickle names. `source` is the unpickler."""

    source: _Unpickler
    full_name: str

    def __init__(self, *_: Any) -> None: ...


class _Dtype(_StandIn):
    def __init__(self, name: str = "", *_: Any) -> None:
        if not isinstance(name, str) or not _DTYPE.fullmatch(name):
            raise ValueError(f"it has an array with the type {name!r:.40}")
        self.numpy = np.dtype(name)

    def __setstate__(self, state: Any) -> None:
        if state[1] in (">", "<"):
            self.numpy = self.numpy.newbyteorder(state[1])


class _Array(_StandIn):
    """An array, empty until its content is set; a list of strings if they are Python objects."""

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
    """An array that joblib wrote behind its description."""

    def __setstate__(self, state: Any) -> None:
        shape, dtype, file = state["shape"], state["dtype"], self.source.file
        if state.get("numpy_array_alignment_bytes") is not None:
            file.read(file.read(1)[0])
        content = file.read(prod(int(n) for n in shape) * dtype.numpy.itemsize)
        self._fill(content, dtype, shape, state["order"])


class _Tensor(_Array):
    """Numbers from a storage, with an offset and strides in numbers."""

    def __init__(
        self, storage: NDArray[Any], offset: int, shape: Any, strides: Any, *_: Any
    ) -> None:
        shape, strides = tuple(map(int, shape)), tuple(map(int, strides))
        last = offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
        if offset < 0 or min((*shape, *strides, 0)) < 0 or (prod(shape) and last >= len(storage)):
            raise ValueError("it has a tensor beyond its storage")
        if prod(shape) > max(len(storage), 1):  # strides of zero could repeat numbers without limit
            raise ValueError("it has a tensor that is larger than its storage")
        steps = [stride * storage.itemsize for stride in strides]
        self.values = np.lib.stride_tricks.as_strided(storage[offset:], shape, steps)


class _Storage(_StandIn):
    """The type of a PyTorch storage."""


class _Other(_StandIn):
    """An unsupported type. Nothing of it is executed."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def _ignore(self, *_: Any) -> None: ...

    append = extend = add = __setitem__ = __setstate__ = _ignore


class _Scalar(_StandIn):
    def __new__(cls, dtype: _Dtype, content: bytes) -> Any:
        cls.source.charge(dtype.numpy.itemsize)
        return np.frombuffer(content, dtype.numpy, count=1)[0].item()


class _Encoded(_StandIn):
    """Bytes in the form of pickle protocol 2."""

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
