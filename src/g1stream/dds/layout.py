"""CDR layouts: byte offsets of all fields of a fixed-size message type, derived once from its IDL.

All types here have only fixed-size fields, so each field has a fixed offset in the CDR payload, and
a sample is read or written through numpy views. The rules are those of XCDR1 (DDSI-RTPS 2.5,
section 10, plain CDR): a primitive is aligned to its own size, counted from the start of the
payload, and a struct is not padded to its own size. Therefore the elements of an array of structs
can have different layouts. In LowCmd, the first motor's `mode` is closer to its `q` than those of
the others.
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

#: First 4 bytes of a sample: representation identifier of plain little-endian CDR, and no options.
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
    """One primitive of a type: path without indices, indices, dtype and offset in the C struct."""

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
    """Iterate over the primitives of a type in wire order."""
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
    """The C layout of an element, with natural alignment and padded structs."""
    if isinstance(element, str):
        return np.dtype(_DTYPES[element])
    fields = [
        (name, _c_struct(member), () if length is None else (length,))
        for name, (member, length) in members(element).items()
    ]
    return np.dtype(fields, align=True)


@dataclass(frozen=True)
class Field:
    """Byte offsets of one field in a payload.

    Attributes:
        offsets: byte offsets within the payload, shaped like the field: () for a scalar, (35,) for
            `motor_cmd.q`, (35, 2) for `motor_state.temperature`.
        dtype: the little-endian primitive at each offset.
    """

    offsets: NDArray[np.intp]
    dtype: np.dtype[Any]

    def read(self, payloads: NDArray[np.uint8]) -> NDArray[Any]:
        """Read the field from payloads (..., size); returns (..., *offsets.shape).

        It is a view of payloads (N, size) if the field's offsets are evenly spaced.
        """
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
            ValueError: the field's offsets are not evenly spaced, so there is no view.
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
        """Distance between offsets along each axis, bytes; None if it is not constant."""
        strides = []
        for axis, length in enumerate(self.offsets.shape):
            steps = np.unique(np.diff(self.offsets, axis=axis)) if length > 1 else np.array([0])
            if steps.size != 1:
                return None
            strides.append(int(steps[0]))
        return tuple(strides)


class Layout:
    """The CDR layout of a fixed-size type, and its mapping to the C struct.

    Attributes:
        typename: name of the type on DDS, such as `unitree_hg.msg.dds_.LowCmd_`.
        size: bytes of the payload, without the 4-byte header.
        sample_size: bytes of a sample from Cyclone, with header and payload, padded to a multiple
            of 4.
        fields: dotted path without indices, such as `motor_cmd.q` -> Field.
        struct_bytes: index of the payload byte for each byte of the C struct (natural alignment);
            `size` for padding.
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
        """Return whether bytes, including the CDR header, are one sample in little-endian CDR."""
        return len(data) == self.sample_size and data[:2] == CDR_HEADER[:2]

    def check(self, data: bytes) -> None:
        """Check that bytes, including the CDR header, are one sample of this type.

        Raises:
            WireError: they have another size or encoding.
        """
        if not self.matches(data):
            raise WireError(
                f"A sample has {len(data)} bytes, encoding 0x{data[:2].hex()}, but "
                f"{self.typename} has {self.sample_size}, encoding 0x{CDR_HEADER[:2].hex()}.",
                "Make the publisher use plain little-endian CDR (XCDR1) and the type in idl/.",
            )

    @staticmethod
    @cache
    def of(idl_type: Any) -> Layout:
        """The layout of a type, derived once per process."""
        return Layout(idl_type)


class Crc:
    """Unitree's checksum: CRC-32/MPEG-2 (polynomial 0x04C11DB7, initial 0xFFFFFFFF) of a C struct.

    The SDK processes the struct's 32-bit words except the last one (the checksum itself), most
    significant bit first. For a little-endian struct this is the byte stream with each group of
    four bytes reversed.

    Args:
        layout: layout of a type whose last field is `crc`.
    """

    def __init__(self, layout: Layout) -> None:
        words = layout.struct_bytes.reshape(-1, 4)
        self._source = np.ascontiguousarray(words[:-1, ::-1]).reshape(-1)
        start = int(layout["crc"].offsets)
        self._stored = slice(start, start + 4)
        # A zero after the payload is used for the padding of the C struct.
        self._padded = np.zeros(layout.size + 1, dtype=np.uint8)
        self._scratch = np.empty(self._source.size, dtype=np.uint8)

    def compute(self, payload: NDArray[np.uint8]) -> int:
        """Compute the checksum of a payload (size,)."""
        self._padded[:-1] = payload
        np.take(self._padded, self._source, out=self._scratch, mode="clip")
        return crc32.mpeg_2(self._scratch.tobytes())

    def compute_many(self, payloads: NDArray[np.uint8]) -> NDArray[np.uint32]:
        """Compute the checksums (N,) of payloads (N, size)."""
        rows = np.pad(payloads, ((0, 0), (0, 1))).take(self._source, axis=1)
        return np.array([crc32.mpeg_2(row.tobytes()) for row in rows], np.uint32)

    def matches(self, payload: NDArray[np.uint8]) -> bool:
        """Return whether the checksum in a payload (size,) is right."""
        return int.from_bytes(payload[self._stored], "little") == self.compute(payload)


def _align(offset: int, alignment: int) -> int:
    return -(-offset // alignment) * alignment
