"""What lies where the parts of a session are about to be written."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.container.reader import McapFile
from g1stream.errors import RecordingError
from g1stream.recording.file_names import parts_named
from g1stream.recording.metadata import session_metadata

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["make_way"]

#: As far as a recording is expected to get. A larger number is a date or the like, which is let
#: be; a recording that gets there after all ends before it.
_LAST: Final = 999


def make_way(path: Path, *, force: bool) -> None:
    """Remove the parts of an earlier session that was called after the same path.

    Nothing is removed unless everything can be that is in the way.

    Args:
        path: the session file that parts are to be named after.
        force: remove the parts of one earlier session; without, they are refused.

    Raises:
        RecordingError: there are such parts and `force` is off, or one of them cannot be removed;
            or something else, which `force` does not remove, has the name of a part.
    """
    named = parts_named(path)
    sessions = {number: _session_of(file, number) for number, file in named.items()}
    earlier = next((session for session in sessions.values() if session is not None), None)
    old = [named[n] for n, session in sessions.items() if session and session == earlier]
    stranger = next((n for n, file in named.items() if 1 <= n <= _LAST and file not in old), None)
    if stranger is not None:
        raise RecordingError(
            f"The file {named[stranger]} has the name of part {stranger} of the recording, and is "
            "not a part of the one that it would replace.",
            "Move it away, choose another name, or give --auto-name to add the time.",
        )
    if old and not force:
        raise RecordingError(
            f"The file {old[0]} exists already.",
            "Choose another name, give --force to replace all its parts, or --auto-name to "
            "add the time.",
        )
    for part in old:
        _remove(part)


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise RecordingError(
            f"The file {path} cannot be removed: {error.strerror}.", "Choose another name or place."
        ) from error


def _session_of(path: Path, number: int) -> str | None:
    """The session of which a file says itself that it is the part of that number."""
    try:
        about = session_metadata(McapFile(path))
    except RecordingError:
        return None
    session = about.get("session_id")
    return session if about.get("part") == number and isinstance(session, str) else None
