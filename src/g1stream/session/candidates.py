"""Which files that are named like parts are a session's: to be read as one, and replaced as one.

A part says itself of which session it is and which part of it. What a power cut leaves of one says
nothing: an empty file, zeros, an MCAP that is damaged or ends before anything was noted in it. That
is a session's where the session should have a part.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from g1stream.errors import RecordingError
from g1stream.session.file_names import part_number
from g1stream.session.magic import is_blank, is_mcap
from g1stream.session.mcap_reader import McapFile
from g1stream.session.metadata import session_metadata

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

__all__ = ["Candidate", "look_at", "parts_among", "remains_among"]

#: What a recorder notes when it ends: behind it no part can follow.
_LAST_WORDS: Final = "recorder"


class Candidate(NamedTuple):
    """A file that may be a part.

    Attributes:
        path: where it is.
        about: what its recorder noted in it; empty where it cannot be read.
        file: None where it cannot be read.
        error: then, why.
        says_nothing: whether nothing in it shows whose it is.
        locked: whether that is so because it may not be opened.
    """

    path: Path
    about: dict[str, Any]
    file: McapFile | None = None
    error: RecordingError | None = None
    says_nothing: bool = False
    locked: bool = False

    @property
    def session(self) -> str | None:
        """The session that it says it is of."""
        session = self.about.get("session_id")
        return session if isinstance(session, str) else None

    @property
    def part(self) -> int | None:
        """The number, from 1, that it says it is; None: it does not say, or is the whole."""
        part = self.about.get("part")
        return part if isinstance(part, int) else None

    @property
    def number(self) -> int | None:
        """The number that it is named with."""
        return part_number(self.path)

    @property
    def reason(self) -> str | None:
        """Why nothing can be had from it, a sentence."""
        if self.error is not None:
            return self.error.cause
        return f"{self.path} ends before anything was noted in it." if self.says_nothing else None


def look_at(path: Path) -> Candidate:
    """See what is in a file."""
    try:
        file = McapFile(path)
        silent = not (file.complete or file.metadata or file.counts or any(file.attachments()))
        return Candidate(path, session_metadata(file), file, says_nothing=silent)
    except RecordingError as error:
        try:
            silent, locked = is_mcap(path) or is_blank(path), False
        except OSError:
            silent = locked = True
        return Candidate(path, {}, error=error, says_nothing=silent, locked=locked)


def parts_among(found: Iterable[Candidate], session: str | None) -> list[Candidate]:
    """Those that say that they are parts of a session, the ones that they are named as."""
    return [
        one
        for one in found
        if session is not None and one.session == session and one.part == one.number is not None
    ]


def remains_among(found: Iterable[Candidate], parts: list[Candidate]) -> list[Candidate]:
    """Those that say nothing, where some parts of a session lack one.

    That is before the last of them; and directly behind it, one after the other, unless its
    recorder had the time to note that it was the last.
    """
    silent = {one.number: one for one in found if one.says_nothing and one.number}
    last = max(parts, key=lambda one: one.part or 0, default=None)
    if last is None or last.part is None:  # a session in one file
        return []
    end = last.part
    if _LAST_WORDS not in last.about:
        while end + 1 in silent:
            end += 1
    return [one for number, one in silent.items() if number <= end]
