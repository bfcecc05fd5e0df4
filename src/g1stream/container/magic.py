"""The bytes that an MCAP file begins and ends with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["MAGIC", "is_mcap"]

MAGIC: Final = b"\x89MCAP0\r\n"

#: Without the format's version: a file of another one is an MCAP all the same.
_NAME: Final = MAGIC[:5]


def is_mcap(path: Path) -> bool:
    """Whether a file begins as an MCAP does; False where there is none that can be read."""
    try:
        with path.open("rb") as file:
            return file.read(len(_NAME)) == _NAME
    except OSError:
        return False
