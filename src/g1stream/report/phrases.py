"""How a motion that was played is told, by the program that played it and from its recording.

Pure, and quick to import.
"""

from __future__ import annotations

from typing import Final

__all__ = ["is_whole", "played"]

#: Played to within this of what was left of the motion, s, it was played to its end: figures are
#: told to a tenth.
_WHOLE: Final = 0.05


def is_whole(start: float, length: float, motion: float) -> bool:
    """Whether so much of a motion from `start` on is all of it, as far as is told; in s."""
    return abs(motion - start - length) < _WHOLE


def played(start: float, length: float, motion: float) -> str:
    """What was played of a motion, once, from `start` on; in s."""
    whence = f"from {start:.1f} s " if start else ""
    if is_whole(start, length, motion):
        return f"played {whence}to its end"
    return f"played {length:.1f} of {motion:.1f} s{whence and f', {whence}on'}"
