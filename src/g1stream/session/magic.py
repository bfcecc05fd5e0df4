"""The bytes that an MCAP file begins and ends with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["MAGIC", "is_blank", "is_mcap"]

MAGIC: Final = b"\x89MCAP0\r\n"

#: Without the format's version: a file of another one is an MCAP all the same.
_NAME: Final = MAGIC[:5]
_BLOCK: Final = 1 << 20


def is_mcap(path: Path) -> bool:
    """Whether a file begins as an MCAP does; False where there is none that can be read.

    What is no regular file is not opened: what is taken from a pipe is gone from it.
    """
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(_NAME)) == _NAME
    except OSError:
        return False


def is_blank(path: Path) -> bool:
    """Whether nothing is in a regular file: it is empty, or zeros, as a power cut leaves it.

    Raises:
        OSError: it cannot be read.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return not any(block.strip(b"\0") for block in iter(lambda: file.read(_BLOCK), b""))
