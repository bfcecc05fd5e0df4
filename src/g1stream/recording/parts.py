"""The files of a session, one or several, read as one."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Final

from g1stream.container.reader import McapFile
from g1stream.errors import RecordingError
from g1stream.recording.file_names import part_number, parts_of
from g1stream.recording.metadata import session_metadata

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from g1stream.container.messages import Messages

__all__ = ["SessionFiles"]

#: What a recorder notes when it ends: behind it no part can follow.
_LAST_WORDS: Final = "recorder"


class SessionFiles:
    """All messages, metadata and attachments of a session, wherever they lie.

    Args:
        path: of the file, or of one of its parts.

    Attributes:
        paths: of the files, oldest first.
        absent: numbers of parts, counted from 1, that should be there and are not, or that cannot
            be read.
        unreadable: of the latter, the reason, a sentence, by number.
        complete: whether everything is there and was closed properly.
        counts: messages of each topic.
        metadata: what the recorder noted; what it noted later replaces what it noted earlier.

    Raises:
        RecordingError: there is no such file, or it is not an MCAP, or it is damaged; another part
            that is so is absent.
    """

    def __init__(self, path: Path) -> None:
        files, broken = _read(path)
        self._files, metadata = _belonging(files, path)
        self.paths = [file.path for file in self._files]
        numbers = {one.get("part", 1) for one in metadata}
        missing = set(range(1, max(numbers))) - numbers
        if _goes_on(metadata):
            missing |= _directly_behind(max(numbers), broken)
        self.absent = sorted(missing)
        self.unreadable = {number: broken[number] for number in self.absent if number in broken}
        self.complete = not self.absent and all(file.complete for file in self._files)
        self.counts: Counter[str] = sum((file.counts for file in self._files), Counter())
        self.metadata = {key: value for one in metadata for key, value in one.items()}

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


def _read(path: Path) -> tuple[list[McapFile], dict[int, str]]:
    """What is named like the parts that a file belongs to, oldest first.

    Others may be named like its parts without being any, nor recordings at all.

    Returns:
        The files, and by the number in its name why another cannot be read.

    Raises:
        RecordingError: the file asked for, or the first of the name asked for, cannot be read.
    """
    parts = parts_of(path)
    wanted = path if path in parts else parts[0]
    found = {part: McapFile(part) if part == wanted else _try(part) for part in parts}
    files = [one for one in found.values() if isinstance(one, McapFile)]
    return files, {
        number: reason
        for part, reason in found.items()
        if isinstance(reason, str) and (number := part_number(part)) is not None
    }


def _try(path: Path) -> McapFile | str:
    """A file, or why it cannot be read."""
    try:
        return McapFile(path)
    except RecordingError as error:
        return error.cause


def _belonging(files: list[McapFile], path: Path) -> tuple[list[McapFile], list[dict[str, Any]]]:
    """Those of some files that belong to the session of one of them, and their metadata."""
    metadata = [session_metadata(file) for file in files]
    given = next((i for i, file in enumerate(files) if file.path == path), 0)
    session_id = metadata[given].get("session_id")
    ours = [
        i
        for i, one in enumerate(metadata)
        if i == given or (session_id is not None and one.get("session_id") == session_id)
    ]
    return [files[i] for i in ours], [metadata[i] for i in ours]


def _goes_on(metadata: list[dict[str, Any]]) -> bool:
    """Whether there may be a part behind the last of those that have this metadata."""
    return "part" in metadata[-1] and _LAST_WORDS not in metadata[-1]


def _directly_behind(last: int, broken: dict[int, str]) -> set[int]:
    """Numbers that go on without a gap behind the last."""
    found: set[int] = set()
    while last + len(found) + 1 in broken:
        found.add(last + len(found) + 1)
    return found
