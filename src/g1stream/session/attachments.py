"""The motion file that goes into a session file beside what was played of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["LARGEST_MOTION", "attach_motion"]

LARGEST_MOTION: Final = 16 * 2**20
"""A larger motion file is not attached, bytes; its SHA-256 is in the metadata in any case."""

_MEDIA_TYPES: Final = {".csv": "text/csv"}
_SESSION: Final = ".mcap"


class _Writer(Protocol):
    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file."""


def attach_motion(writer: _Writer, source: Path | None, time_ns: int) -> None:
    """Attach the file that a motion came from, unless it is large, gone or a session itself.

    Of a session that is played or converted again, the messages hold all that matters.

    Args:
        writer: of the session file.
        source: the motion file; None for a motion that came from none.
        time_ns: the attachment's time, ns since the epoch.

    Raises:
        RecordingError: the session file cannot be written.
    """
    if source is None or source.suffix.lower() == _SESSION:
        return
    try:
        if not source.is_file() or source.stat().st_size > LARGEST_MOTION:
            return
        data = source.read_bytes()
    except OSError:  # it was read before: a file that is gone by now is not worth a recording
        return
    kind = _MEDIA_TYPES.get(source.suffix.lower(), "application/octet-stream")
    writer.attach(source.name, kind, data, time_ns)
