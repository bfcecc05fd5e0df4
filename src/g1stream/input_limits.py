"""Limits on input from untrusted files: how much is read, unpacked, computed or printed.

All limits are far above the sizes of real motions, robots and sessions.
"""

from __future__ import annotations

from typing import Any, Final

__all__ = [
    "CSV_LINE",
    "FRAMES",
    "LATEST_NS",
    "MESHES",
    "MOTION_FILE",
    "NUMBER",
    "SESSION_RATIO",
    "SETTINGS_DOTS",
    "SETTINGS_FILE",
    "SMALL_FILE",
    "TEXT",
    "UNPACKED",
    "URDF_LINKS",
    "check_integers",
]

NUMBER: Final = 1e9
"""Largest number, in any unit; squares and products of larger numbers overflow."""
LATEST_NS: Final = 2**62
"""Latest time, ns since the epoch (in 2116), so that the sum of two times fits into 64 bits."""

SETTINGS_FILE: Final = 2**20
"""Bytes of a TOML file or metadata.yaml; their Python parsers take seconds for this size."""
SETTINGS_DOTS: Final = 128
"""Dots in a line of a TOML file; its parser takes time and memory for the square of a key's parts.
An array of numbers has one for each."""
SMALL_FILE: Final = 16 * 2**20
"""Bytes of a URDF, a correction, or any other file that is read whole and has no other limit."""
MOTION_FILE: Final = 2**30
"""Bytes of a motion file; enough for an hour at 500 Hz."""
CSV_LINE: Final = 2**16
"""Bytes of a line of a CSV file; a line of a motion has about 40 numbers."""
MESHES: Final = 256 * 2**20
"""Bytes of a mesh, and of all meshes in a scene, where a repeated mesh counts each time."""
UNPACKED: Final = 512 * 2**20
"""Unpacked bytes of an archive, pickle, record, chunk or topic; a few packed bytes, or a number in
a header, can claim more than the memory holds."""
SESSION_RATIO: Final = 100
"""Ratio of unpacked chunks to the size of a session file, beyond `UNPACKED`; samples compress to a
fifth of their size."""

URDF_LINKS: Final = 1000
"""Links, and joints, of a URDF; a G1 with hands has 60, and each costs computation per step."""
FRAMES: Final = 500_000
"""Frames at which a recording is sampled; two samples can be a century apart."""
TEXT: Final = 2000
"""Printed characters of a value or a sentence."""


def check_integers(values: Any) -> None:
    """Raise a ValueError if a parsed file has an integer of more than 64 bits.

    Python computes with it, but cannot make a float of it, or print it.
    """
    left, seen = [values], set[int]()
    while left:
        one = left.pop()
        if isinstance(one, int) and one.bit_length() > 64:
            raise ValueError("an integer has more than 64 bits")
        if isinstance(one, (dict, list)) and id(one) not in seen:  # YAML repeats lists
            seen.add(id(one))
            left += one.values() if isinstance(one, dict) else one
