"""What a file, which may come from anywhere, can make us read, unpack, compute or print.

All are far above what motions, robots and sessions have.
"""

from __future__ import annotations

from typing import Final

__all__ = [
    "CSV_LINE",
    "FRAMES",
    "LATEST_NS",
    "MESHES",
    "MOTION_FILE",
    "NUMBER",
    "PICKLE_VALUES",
    "SESSION_RATIO",
    "SETTINGS_FILE",
    "SMALL_FILE",
    "TEXT",
    "UNPACKED",
    "URDF_LINKS",
]

NUMBER: Final = 1e9
"""Of any unit: squares and products of larger numbers overflow."""
LATEST_NS: Final = 2**62
"""Times are before this, ns since the epoch (in 2116), so that sums of two are 64-bit numbers."""

SETTINGS_FILE: Final = 2**20
"""Bytes of a TOML file or metadata.yaml: their parsers, in Python, take seconds for these."""
SMALL_FILE: Final = 16 * 2**20
"""Bytes of a URDF, a correction, or any other file that is read whole and has no limit here."""
MOTION_FILE: Final = 2**30
"""Bytes: an hour at 500 Hz."""
CSV_LINE: Final = 2**16
"""Bytes of a line of a CSV file: a motion has some 40 numbers in each."""
MESHES: Final = 256 * 2**20
"""Bytes of a mesh, and of all in a scene as often as they occur: a URDF may repeat one."""
UNPACKED: Final = 512 * 2**20
"""Bytes of what one archive, pickle, record, chunk or topic holds: a few packed bytes, or a number
in a header, can claim more than any memory has."""
SESSION_RATIO: Final = 100
"""Bytes that the chunks of a session unpack to, for each of its file and beyond `UNPACKED`: samples
compress to a fifth."""

PICKLE_VALUES: Final = 5_000_000
"""Numbers, texts and containers outside of arrays: lists can refer to a list many times over."""
URDF_LINKS: Final = 1000
"""Links, and joints: a G1 with hands has 60, and every one costs work at each step."""
FRAMES: Final = 500_000
"""Frames that a recording is sampled at: two samples can be a century apart."""
TEXT: Final = 2000
"""Characters of a value or a sentence that are printed."""
