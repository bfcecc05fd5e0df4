"""What lies where the parts of a session are about to be written."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.errors import RecordingError
from g1stream.session.candidates import look_at, parts_among, remains_among
from g1stream.session.file_names import is_there, parts_named

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from g1stream.session.candidates import Candidate

__all__ = ["earlier_files", "remove"]

#: As far as a recording is expected to get. A larger number is a date or the like, which is let
#: be; a recording that gets there after all ends before it.
_LAST: Final = 999

_MOVE_IT: Final = "Move it away, choose another name, or give --auto-name to add the time."


def earlier_files(path: Path, *, force: bool) -> list[Path]:
    """The files of an earlier session that the parts of a new one are to replace.

    They are its parts, what a power cut left of some, and the file that is called after the path
    itself, which would be opened in place of the new parts. Nothing is removed here.

    Args:
        path: the session file that parts are to be named after.
        force: whether anything may be replaced; without, whatever is there is refused.

    Raises:
        RecordingError: something is there and `force` is off; or it is something else, which
            `force` does not replace; or the directory cannot be read.
    """
    parts = _earlier_parts(path)
    whole = _earlier_whole(path)
    old = [*parts, *whole]
    if old and not force:
        raise RecordingError(
            f"The file {old[0]} exists already.",
            f"Choose another name, give --force to replace {'all its parts' if parts else 'it'}, "
            "or --auto-name to add the time.",
        )
    return old


def remove(paths: Iterable[Path]) -> None:
    """Remove files, one after the other.

    Raises:
        RecordingError: one cannot be removed; those behind it are still there.
    """
    for path in paths:
        _remove(path)


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise RecordingError(
            f"The file {path} cannot be removed: {error.strerror}.", "Choose another name or place."
        ) from error


def _earlier_parts(path: Path) -> list[Path]:
    """The parts of one earlier session, and their remains; anything else is refused."""
    named = {number: look_at(file) for number, file in parts_named(path).items()}
    found = [*named.values()]
    parts = parts_among(found, _first_session(found))
    remains = [one for one in remains_among(found, parts) if not one.locked]
    old = sorted(one.path for one in (*parts, *remains))
    for number, one in named.items():
        if 1 <= number <= _LAST and one.path not in old:
            raise RecordingError(
                f"The file {one.path} has the name of part {number} of the recording, and nothing "
                "shows that it is a part of the one that would be replaced.",
                _MOVE_IT,
            )
    return old


def _earlier_whole(path: Path) -> list[Path]:
    """The earlier session in the file of the name itself; any other file is refused."""
    if not is_there(path):
        return []
    if look_at(path).session is None:
        raise RecordingError(
            f"{path} would be opened in place of the parts called after it, and is no session that "
            "could be replaced.",
            _MOVE_IT,
        )
    return [path]


def _first_session(found: Iterable[Candidate]) -> str | None:
    """The session of the first that says that it is the part it is named as."""
    return next((one.session for one in found if one.session and one.part == one.number), None)
