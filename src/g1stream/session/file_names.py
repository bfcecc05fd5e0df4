"""What the files of a session are called.

The parts of `session.mcap` are `session_001.mcap`, `session_002.mcap` and so on.
"""

from __future__ import annotations

import re
from datetime import datetime, timezone
from pathlib import Path
from typing import Final

from g1stream.errors import RecordingError

__all__ = ["is_there", "part_number", "part_path", "parts_named", "parts_of", "timestamped"]

_PART: Final = re.compile(r"(?P<stem>.+)_(?P<number>[0-9]{3}|[1-9][0-9]{3,})")


def timestamped(path: str | Path, now_ns: int) -> Path:
    """The path with the time, UTC, in its name: `session-20260301T120000Z.mcap`.

    Args:
        path: of the session.
        now_ns: the time, ns since the epoch.
    """
    path = Path(path)
    now = datetime.fromtimestamp(now_ns // 1_000_000_000, timezone.utc)
    return path.with_name(f"{path.stem}-{now:%Y%m%dT%H%M%SZ}{path.suffix}")


def part_path(path: Path, number: int) -> Path:
    """The part of a session, counted from 1, by the path that the session is called after."""
    return path.with_name(f"{path.stem}_{number:03}{path.suffix}")


def part_number(path: Path) -> int | None:
    """The number that a file is named with; None if it is not named like a part."""
    match = _PART.fullmatch(path.stem)
    return int(match["number"]) if match else None


def parts_named(path: Path) -> dict[int, Path]:
    """By number, in order, what is named like a part of the session of a path.

    Whether it is one is not looked at: see `g1stream.session.candidates`.

    Raises:
        RecordingError: the directory may not be read.
    """
    found = {}
    for file in _listed(path.parent):
        number = part_number(file)
        if number is not None and file == part_path(path, number):
            found[number] = file
    return dict(sorted(found.items()))


def parts_of(path: str | Path) -> list[Path]:
    """The parts that lie beside a part, in order, itself included; or of the name they are after.

    A file that is no part is its own and only one. Whether files belong together is said by the
    `session_id` in their metadata, which is not looked at here.

    Raises:
        RecordingError: the directory would have to be read and may not be.
    """
    path = Path(path)
    match = _PART.fullmatch(path.stem)
    there = is_there(path)
    if match and there:
        found = [*parts_named(path.with_name(match["stem"] + path.suffix)).values()]
        return found if path in found else [path]
    return [path] if there else [*parts_named(path).values()] or [path]


def is_there(path: Path) -> bool:
    """Whether a file is there, as far as one may look."""
    try:
        return path.exists()
    except OSError:
        return False


def _listed(directory: Path) -> list[Path]:
    try:
        return [*directory.iterdir()]
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise RecordingError(
            f"The directory {directory} cannot be read: {error.strerror}.",
            "Parts of the session are looked for in it: see to its permissions.",
        ) from error
