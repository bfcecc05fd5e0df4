"""The files of a session, one or several, read as one."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from g1stream.errors import RecordingError
from g1stream.session.candidates import look_at, parts_among, remains_among
from g1stream.session.file_names import parts_of
from g1stream.session.magic import is_mcap

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from g1stream.session.candidates import Candidate
    from g1stream.session.source import Messages

__all__ = ["SessionFiles"]


class SessionFiles:
    """All messages, metadata and attachments of a session, wherever they lie.

    Args:
        path: of the file, or of one of its parts.

    Attributes:
        path: as given.
        paths: of the files, oldest first.
        absent_parts: numbers of parts, from 1, that should be there and are not, or that cannot
            be read.
        unreadable_parts: of the latter, the reason, a sentence, by number.
        complete: whether everything is there and was closed properly.
        topics: messages of each topic.
        metadata: what the recorder noted; what it noted later replaces what it noted earlier.

    Raises:
        RecordingError: there is no such file, or it is not an MCAP, or it is damaged; another part
            that is so is absent.
    """

    def __init__(self, path: Path) -> None:
        given, found = _look_around(path)
        others = parts_among(found, given.session)
        parts = [one for one in found if one is given or one in others]
        self.path = path
        self._files = [one.file for one in parts if one.file is not None]
        self.paths = [file.path for file in self._files]
        numbers = {one.part or 1 for one in parts}
        missing = {*range(1, max(numbers))} - numbers
        missing |= {one.number for one in remains_among(found, parts) if one.number} - numbers
        self.absent_parts = sorted(missing)
        self.unreadable_parts = {
            one.number: one.reason
            for one in found
            if one.number and one.number in missing and one.reason
        }
        self.complete = not self.absent_parts and all(file.complete for file in self._files)
        counts: Counter[str] = sum((file.counts for file in self._files), Counter())
        self.topics = dict(counts)
        self.metadata = {key: value for one in parts for key, value in one.about.items()}

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, one batch per channel and chunk, in the order of the files.

        Raises:
            RecordingError: a chunk is damaged.
        """
        for file in self._files:
            yield from file.batches(topics)

    def attachments(self) -> dict[str, bytes]:
        """The attached files by name.

        Raises:
            RecordingError: one of them is damaged.
        """
        return {one.name: one.data for file in self._files for one in file.attachments()}


def _look_around(path: Path) -> tuple[Candidate, list[Candidate]]:
    """The file that was asked for, and all that is named like the parts that it belongs to.

    Of a name that parts are called after, the first of them is the one that was asked for.

    Raises:
        RecordingError: the file asked for cannot be read.
    """
    paths = parts_of(path)
    found = [look_at(one) for one in paths]
    given = found[paths.index(path) if path in paths else 0]
    if given.error is not None:
        if not given.locked and given.path.is_file() and not is_mcap(given.path):
            raise RecordingError(given.error.cause, "Give a file that g1stream recorded.")
        raise given.error
    return given, found
