"""From a type on the wire to the place of each of its fields in the bytes, derived once.

Every type here has only fixed-size fields, so each field has one place in the CDR payload, and
reading or writing a sample is a numpy view. The rules are those of XCDR1 (DDSI-RTPS 2.5, section
10, plain CDR): a primitive is aligned to its own size counted from the start of the payload, and a
struct is not padded to its own size. The elements of an array of structs therefore need not all
look the same: in LowCmd the first motor's `mode` sits closer to its `q` than those of the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Final, get_args, get_type_hints

import numpy as np
from fastcrc import crc32

from g1stream.errors import WireError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

__all__ = ["CDR_HEADER", "Crc", "Field", "Layout", "Leaf", "leaves", "members"]

#: Representation identifier of plain CDR, little endian, and no options: the first 4 bytes of a
#: sample.
CDR_HEADER: Final = b"\x00\x01\x00\x00"

_DTYPES: Final[dict[str, str]] = {
    "byte": "u1",
    "uint8": "u1",
    "int16": "<i2",
    "int32": "<i4",
    "uint32": "<u4",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}


@dataclass(frozen=True)
class Leaf:
    """One primitive of a type: its path without indices, its indices, dtype and place in C."""

    path: str
    index: tuple[int, ...]
    dtype: np.dtype[Any]
    c_offset: int


def members(idl_type: Any) -> dict[str, tuple[Any, int | None]]:
    """The fields of a struct in wire order: name -> (element type, array length or None).

    The element type is another struct class or the IDL name of a primitive, such as `float32`.
    """
    found: dict[str, tuple[Any, int | None]] = {}
    for name, hint in get_type_hints(idl_type, include_extras=True).items():
        mark = get_args(hint)[1] if get_args(hint) else hint
        length = getattr(mark, "length", None)
        element = mark if length is None else mark.subtype
        found[name] = (get_args(element)[1] if get_args(element) else element, length)
    return found


def leaves(idl_type: Any) -> Iterator[Leaf]:
    """Walk the primitives of a type in wire order."""
    return _leaves(idl_type, _c_struct(idl_type), "", (), 0)


def _leaves(
    idl_type: Any, struct: np.dtype[Any], path: str, index: tuple[int, ...], start: int
) -> Iterator[Leaf]:
    for name, (element, length) in members(idl_type).items():
        assert struct.fields
        dtype, offset = struct.fields[name][:2]
        below = f"{path}.{name}" if path else name
        for i in range(1 if length is None else length):
            place = index if length is None else (*index, i)
            at = start + offset + i * dtype.base.itemsize
            if isinstance(element, str):
                yield Leaf(below, place, dtype.base, at)
            else:
                yield from _leaves(element, dtype.base, below, place, at)


def _c_struct(element: Any) -> np.dtype[Any]:
    """An element as a C compiler lays it out: natural alignment, structs padded to theirs."""
    if isinstance(element, str):
        return np.dtype(_DTYPES[element])
    fields = [
        (name, _c_struct(member), () if length is None else (length,))
        for name, (member, length) in members(element).items()
    ]
    return np.dtype(fields, align=True)


@dataclass(frozen=True)
class Field:
    """The places of one field in a payload.

    Attributes:
        offsets: byte offsets within the payload, shaped like the field: () for a scalar, (35,) for
            `motor_cmd.q`, (35, 2) for `motor_state.temperature`.
        dtype: the little-endian primitive at each of them.
    """

    offsets: NDArray[np.intp]
    dtype: np.dtype[Any]

    def read(self, payloads: NDArray[np.uint8]) -> NDArray[Any]:
        """The field in payloads (..., size) as (..., *offsets.shape); of many a view if it can."""
        if payloads.ndim == 2 and self.strides is not None:  # without an index for each byte
            start = int(self.offsets.flat[0])
            first = payloads[:, start : start + self.dtype.itemsize].view(self.dtype)
            return np.lib.stride_tricks.as_strided(
                first,
                (len(payloads), *self.offsets.shape),
                (payloads.strides[0], *self.strides),
                writeable=False,
            )
        places = self.offsets[..., np.newaxis] + np.arange(self.dtype.itemsize)
        picked = np.ascontiguousarray(payloads[..., places])
        values: NDArray[Any] = picked.view(self.dtype)[..., 0]
        return values

    def view(self, payload: NDArray[np.uint8]) -> NDArray[Any]:
        """A writable view of the field in one contiguous payload (size,).

        Raises:
            ValueError: the field's places are not evenly spaced, so that no view can show them.
        """
        if self.strides is None:
            raise ValueError("the field is not evenly spaced in the payload")
        start = int(self.offsets.flat[0])
        shown: NDArray[Any] = np.ndarray(
            self.offsets.shape, self.dtype, payload.data, start, self.strides
        )
        return shown

    @cached_property
    def strides(self) -> tuple[int, ...] | None:
        """Bytes from one place to the next along each axis; None where they differ."""
        strides = []
        for axis, length in enumerate(self.offsets.shape):
            steps = np.unique(np.diff(self.offsets, axis=axis)) if length > 1 else np.array([0])
            if steps.size != 1:
                return None
            strides.append(int(steps[0]))
        return tuple(strides)


class Layout:
    """Where each field of a fixed-size type sits in its CDR payload and in its C struct.

    Attributes:
        typename: the type's name on the wire, such as `unitree_hg.msg.dds_.LowCmd_`.
        size: bytes of the payload, without the 4-byte header.
        sample_size: bytes of a sample as Cyclone hands it over: the header and the payload, padded
            to a multiple of 4.
        fields: dotted path without indices, such as `motor_cmd.q` -> Field.
        struct_bytes: for each byte of the C struct (natural alignment), the payload byte that it
            shows; `size` where it is padding.
    """

    def __init__(self, idl_type: Any) -> None:
        self.typename: str = idl_type.__idl_typename__
        offsets: dict[str, list[int]] = {}
        dtypes: dict[str, np.dtype[Any]] = {}
        shapes: dict[str, tuple[int, ...]] = {}
        self.struct_bytes = np.full(_c_struct(idl_type).itemsize, -1, dtype=np.intp)
        end = 0
        for leaf in leaves(idl_type):
            size = leaf.dtype.itemsize
            start = _align(end, size)
            end = start + size
            offsets.setdefault(leaf.path, []).append(start)
            dtypes[leaf.path] = leaf.dtype
            shapes[leaf.path] = tuple(i + 1 for i in leaf.index)
            self.struct_bytes[leaf.c_offset : leaf.c_offset + size] = np.arange(start, end)
        self.size = end
        self.struct_bytes[self.struct_bytes < 0] = self.size
        self.sample_size = len(CDR_HEADER) + _align(end, 4)
        self.fields = {
            path: Field(np.array(places, dtype=np.intp).reshape(shapes[path]), dtypes[path])
            for path, places in offsets.items()
        }

    def __getitem__(self, path: str) -> Field:
        return self.fields[path]

    def matches(self, data: bytes) -> bool:
        """Whether bytes, CDR header included, are one sample in plain little-endian CDR."""
        return len(data) == self.sample_size and data[:2] == CDR_HEADER[:2]

    def check(self, data: bytes) -> None:
        """Raise a WireError unless bytes, CDR header included, are one sample of this type."""
        if not self.matches(data):
            raise WireError(
                f"A sample has {len(data)} bytes, encoding 0x{data[:2].hex()}, but "
                f"{self.typename} has {self.sample_size}, encoding 0x{CDR_HEADER[:2].hex()}.",
                "Make the publisher use plain little-endian CDR (XCDR1) and the type in idl/.",
            )

    @staticmethod
    @cache
    def of(idl_type: Any) -> Layout:
        """The layout of a type, derived once for each process."""
        return Layout(idl_type)


class Crc:
    """Unitree's checksum: CRC-32/MPEG-2 (polynomial 0x04C11DB7, initial 0xFFFFFFFF) of a C struct.

    The SDK feeds the struct's 32-bit words, all but the last (the checksum itself), most
    significant bit first. In a little-endian struct that is the byte stream with each group of four
    reversed.

    Args:
        layout: of a type whose last field is `crc`.
    """

    def __init__(self, layout: Layout) -> None:
        words = layout.struct_bytes.reshape(-1, 4)
        self._source = np.ascontiguousarray(words[:-1, ::-1]).reshape(-1)
        start = int(layout["crc"].offsets)
        self._stored = slice(start, start + 4)
        # One zero beyond the payload stands for the padding of the C struct.
        self._padded = np.zeros(layout.size + 1, dtype=np.uint8)
        self._scratch = np.empty(self._source.size, dtype=np.uint8)

    def compute(self, payload: NDArray[np.uint8]) -> int:
        """The checksum that a payload (size,) ought to carry."""
        self._padded[:-1] = payload
        np.take(self._padded, self._source, out=self._scratch, mode="clip")
        return crc32.mpeg_2(self._scratch.tobytes())

    def matches(self, payload: NDArray[np.uint8]) -> bool:
        """Whether a payload (size,) carries its own checksum."""
        return int.from_bytes(payload[self._stored], "little") == self.compute(payload)


def _align(offset: int, alignment: int) -> int:
    return -(-offset // alignment) * alignment
