"""Metadata and attachments of a session.

The metadata are JSON values, kept in MCAP's map of strings.

Strings are kept as they are, so that every MCAP tool shows them plainly; everything else becomes
JSON. A string that would read as JSON (`0.10`, `true`) is quoted, so that it comes back a string.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final, Protocol

from g1stream.files import is_session

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = [
    "LARGEST_MOTION",
    "METADATA_NAME",
    "attach_motion",
    "metadata_from_strings",
    "metadata_to_strings",
]

METADATA_NAME: Final = "g1stream"
"""The name of the record. A file may have several; a later one's values replace an earlier's."""


LARGEST_MOTION: Final = 16 * 2**20
"""A larger motion file is not attached, bytes; its SHA-256 is in the metadata in any case."""


class _Writer(Protocol):
    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file."""


def attach_motion(writer: _Writer, source: Path | None, time_ns: int) -> None:
    """Attach the file that a motion came from, unless it is large, gone or a session itself.

    Of a session that is played or converted again, the messages hold all that matters.

    Args:
        writer: of the session.
        source: the motion file; None for a motion that came from none.
        time_ns: the attachment's time, ns since the epoch.

    Raises:
        RecordingError: the session cannot be written.
    """
    if source is None or is_session(source):
        return
    try:
        if not source.is_file() or source.stat().st_size > LARGEST_MOTION:
            return
        data = source.read_bytes()
    except OSError:  # a file that is gone by now is not worth a recording
        return
    kind = "text/csv" if source.suffix.lower() == ".csv" else "application/octet-stream"
    writer.attach(source.name, kind, data, time_ns)


def metadata_to_strings(values: Mapping[str, Any]) -> dict[str, str]:
    """Flatten values for MCAP.

    Raises:
        TypeError: a value is neither JSON nor a numpy array or scalar.
    """
    return {key: _to_string(value) for key, value in values.items()}


def metadata_from_strings(strings: Mapping[str, str]) -> dict[str, Any]:
    """The values that `metadata_to_strings` flattened."""
    return {key: _from_string(string) for key, string in strings.items()}


def _to_string(value: Any) -> str:
    if isinstance(value, str) and _from_string(value) is value:
        return value
    return json.dumps(value, default=_from_numpy)


def _from_string(string: str) -> Any:
    try:
        return json.loads(string)
    except ValueError:
        return string


def _from_numpy(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")
