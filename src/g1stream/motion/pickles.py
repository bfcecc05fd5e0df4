"""Arrays in plain containers from pickles, without running anything or trusting a claimed size."""

from __future__ import annotations

import io
import pickle
import re
import struct
import sys
import zlib
from math import prod
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from g1stream.input_limits import PICKLE_VALUES, UNPACKED

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

__all__ = ["ArrayStandIn", "Unpickler", "is_pickle", "read_pickle"]

#: How deep numbers and texts that are not in an array may be in containers.
_DEPTH: Final = 4
#: Bytes of a character in an array of texts, each of which is as long as the longest.
_CHARACTER: Final = 4
#: Calls what is on the stack.
_REDUCE: Final[Any] = pickle._Unpickler.dispatch[pickle.REDUCE[0]]
#: The types of numbers and texts that arrays may have; texts may be Python objects.
_DTYPE: Final = re.compile(r"[<>|=]?([biufSU][0-9]{1,5}|O8?)")


def is_pickle(data: bytes) -> bool:
    """Whether content begins as that of a pickle, plain or compressed, does.

    A pickle of protocol 0 or 1 looks like text; none of those who write motions use them.
    """
    return data[:1] == pickle.PROTO or _is_compressed(data)


def read_pickle(data: bytes) -> Any:
    """What is in a pickle, or in a file of joblib, if it is arrays in plain containers.

    Numbers, texts, lists, tuples, dicts and arrays of numbers or texts are read; anything else is
    refused by its name. numpy's own functions are not called either: they would allocate whatever
    the file claims.

    Args:
        data: content of the file; compressed with zlib or gzip, or not.

    Raises:
        ValueError: there is something else in it, or it is damaged or larger than 512 MiB unpacked.
    """
    if _is_compressed(data):
        data = _decompressed(data)
    try:
        return Unpickler(io.BytesIO(data)).load()
    except ValueError:
        raise
    except Exception as error:  # a damaged pickle raises whatever its last operation raises
        raise ValueError(f"it is a damaged pickle: {error!r:.80}") from error


def _is_compressed(data: bytes) -> bool:
    return data[:2] in (b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda", b"\x1f\x8b")


def _decompressed(data: bytes) -> bytes:
    decompressor = zlib.decompressobj(wbits=zlib.MAX_WBITS + 32)  # zlib or gzip
    try:
        content = decompressor.decompress(data, UNPACKED)
    except zlib.error as error:
        raise ValueError(f"it cannot be unpacked: {error}") from error
    if decompressor.unconsumed_tail:
        raise _too_large()
    return content


def _too_large() -> ValueError:
    return ValueError(f"it is larger than {UNPACKED / 2**20:g} MiB unpacked")


class _Dtype:
    """Stands for numpy.dtype in a pickle."""

    def __init__(self, name: str = "", *_: Any) -> None:
        if not isinstance(name, str) or not _DTYPE.fullmatch(name):
            raise ValueError(f"it has an array of the type {name!r:.40}")
        self.numpy = np.dtype(name)

    def __setstate__(self, state: Any) -> None:
        if state[1] in (">", "<"):
            self.numpy = self.numpy.newbyteorder(state[1])


class ArrayStandIn:
    """Stands for an array in a pickle, until its content is known.

    Attributes:
        values: the array; empty until its state is set.
    """

    values: NDArray[Any] = np.empty(0)

    def __init__(self, *_: Any) -> None: ...

    def __setstate__(self, state: Any) -> None:
        _, shape, dtype, column_major, content = state
        self.values = _shaped(content, dtype, shape, "F" if column_major else "C")


class _JoblibArray:
    """Stands for an array that joblib has written behind the description of it."""

    def __init__(self, *_: Any) -> None: ...

    def __setstate__(self, state: Any) -> None:
        self._shape, self._dtype, self._order = state["shape"], state["dtype"], state["order"]
        self._padded = state.get("numpy_array_alignment_bytes") is not None

    def read(self, file: io.BytesIO) -> NDArray[Any]:
        if self._padded:
            file.read(file.read(1)[0])
        size = prod(int(n) for n in self._shape) * self._dtype.numpy.itemsize
        return _shaped(file.read(size), self._dtype, self._shape, self._order)


def _shaped(content: Any, dtype: _Dtype, shape: Any, order: Any) -> NDArray[Any]:
    if dtype.numpy.hasobject:
        if not isinstance(content, list) or not all(isinstance(one, str) for one in content):
            raise ValueError("it has an array of Python objects")
        if len(content) * max(map(len, content), default=0) * _CHARACTER > UNPACKED:
            raise _too_large()
        values = np.array(content)
    else:
        values = np.frombuffer(content, dtype.numpy)
    return values.reshape(tuple(shape), order="F" if order == "F" else "C")


def _array_of_buffer(content: Any, dtype: _Dtype, shape: Any, order: Any) -> ArrayStandIn:
    array = ArrayStandIn()
    array.values = _shaped(content, dtype, shape, order)
    return array


def _encoded(text: str, _encoding: str) -> bytes:
    """Bytes as protocol 2 writes them."""
    return text.encode("latin1")


def _scalar(dtype: _Dtype, content: Any) -> Any:
    return _shaped(content, dtype, (), "C").item()


class Unpickler(pickle._Unpickler):
    """The unpickler in Python with a choice of operations, names of ours, and joblib's arrays."""

    #: Numbers, texts, bytes, containers, and what arrays are made with.
    dispatch: ClassVar[dict[int, Any]] = {
        operation[0]: pickle._Unpickler.dispatch[operation[0]]
        for operation in (
            *(pickle.PROTO, pickle.FRAME, pickle.STOP, pickle.MARK, pickle.POP),
            *(pickle.MEMOIZE, pickle.BINPUT, pickle.LONG_BINPUT),
            *(pickle.BINGET, pickle.LONG_BINGET),
            *(pickle.NONE, pickle.NEWTRUE, pickle.NEWFALSE, pickle.BINFLOAT),
            *(pickle.BININT, pickle.BININT1, pickle.BININT2, pickle.LONG1, pickle.LONG4),
            *(pickle.SHORT_BINUNICODE, pickle.BINUNICODE, pickle.BINUNICODE8),
            *(pickle.SHORT_BINBYTES, pickle.BINBYTES, pickle.BINBYTES8),
            *(pickle.EMPTY_LIST, pickle.APPEND, pickle.APPENDS),
            *(pickle.EMPTY_DICT, pickle.SETITEM, pickle.SETITEMS),
            *(pickle.EMPTY_TUPLE, pickle.TUPLE),
            *(pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3),
            *(pickle.GLOBAL, pickle.STACK_GLOBAL, pickle.REDUCE, pickle.NEWOBJ),
        )
    }
    stack: list[Any]
    read: Callable[[int], bytes]
    append: Callable[[Any], None]

    known: ClassVar[Mapping[tuple[str, str], Callable[..., Any]]] = {
        ("numpy", "ndarray"): ArrayStandIn,
        ("numpy", "dtype"): _Dtype,
        ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
        ("collections", "OrderedDict"): dict,
        ("_codecs", "encode"): _encoded,
        **{
            (f"numpy.{core}.{module}", name): stand_in
            for core in ("core", "_core")
            for module, name, stand_in in (
                ("multiarray", "_reconstruct", ArrayStandIn),
                ("multiarray", "scalar", _scalar),
                ("numeric", "_frombuffer", _array_of_buffer),
            )
        },
    }

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self._file = file
        self._left = UNPACKED

    def find_class(self, module: str, name: str) -> Any:
        known = self.known.get((module, name))
        if known is None:
            raise ValueError(f"it is a pickle with a {module}.{name}, which is not read")
        return known

    def load(self) -> Any:
        return _Plain().of(super().load())

    def _count(self, made: Any) -> None:
        """Count the memory of what a call has made: it may copy what is in the file only once."""
        if not isinstance(made, ArrayStandIn):
            self._left -= sys.getsizeof(made)
        elif made.values.dtype.kind == "U":  # arrays of numbers are views
            self._left -= made.values.nbytes
        if self._left < 0:
            raise _too_large()

    def _reduce(self) -> None:
        _REDUCE(self)
        self._count(self.stack[-1])

    dispatch[pickle.REDUCE[0]] = _reduce

    def _bytearray(self) -> None:
        # The standard one allocates the claimed size before it reads.
        (size,) = struct.unpack("<Q", self.read(8))
        self.append(self.read(size))

    dispatch[pickle.BYTEARRAY8[0]] = _bytearray

    def _build(self) -> None:
        stand_in = self.stack[-2]
        if not isinstance(stand_in, (ArrayStandIn, _Dtype, _JoblibArray)):
            raise ValueError(f"it is a pickle that changes a {type(stand_in).__name__}")
        stand_in.__setstate__(self.stack.pop())
        self._count(stand_in)
        if isinstance(stand_in, _JoblibArray):
            array = self.stack[-1] = ArrayStandIn()
            array.values = stand_in.read(self._file)

    dispatch[pickle.BUILD[0]] = _build


class _Plain:
    """Puts arrays in the place of what stands for them, down to lists in a dict of dicts.

    References to one list count each time, so that no small file becomes a large one.
    """

    def __init__(self) -> None:
        self._left = PICKLE_VALUES

    def of(self, value: Any, depth: int = 0) -> Any:
        self._left -= 1
        if self._left < 0:
            raise ValueError(f"it is a pickle of more than {PICKLE_VALUES:,} single values")
        if isinstance(value, ArrayStandIn):
            return value.values
        if depth < _DEPTH and isinstance(value, dict):
            return {str(name): self.of(one, depth + 1) for name, one in value.items()}
        if depth < _DEPTH and isinstance(value, (list, tuple)):
            return [self.of(one, depth + 1) for one in value]
        return value if isinstance(value, (bool, int, float, str)) else None
