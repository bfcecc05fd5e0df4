"""Unitree's checksum of LowCmd and LowState."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from fastcrc import crc32

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.dds.layout import Layout

__all__ = ["Crc"]


class Crc:
    """CRC-32/MPEG-2 (polynomial 0x04C11DB7, initial 0xFFFFFFFF) of a type's C struct.

    The SDK feeds the struct's 32-bit words, all but the last (the checksum itself), most
    significant bit first. In a little-endian struct that is the byte stream with each group of four
    reversed.

    Args:
        layout: of a type whose last field is `crc`.
    """

    def __init__(self, layout: Layout) -> None:
        words = layout.struct_bytes.reshape(-1, 4)
        self._source = np.ascontiguousarray(words[:-1, ::-1]).reshape(-1)
        self._stored = layout["crc"]
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
        return int(self._stored.read(payload)) == self.compute(payload)
