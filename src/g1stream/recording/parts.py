"""The files of a session, one or several, read as one."""

from __future__ import annotations

from collections import Counter
from contextlib import nullcontext, suppress
from typing import TYPE_CHECKING, Any

from g1stream.container.reader import McapFile
from g1stream.errors import RecordingError
from g1stream.recording.metadata import METADATA_NAME, metadata_from_strings
from g1stream.recording.rotation import parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from g1stream.container.messages import Messages

__all__ = ["SessionFiles"]


class SessionFiles:
    """All messages, metadata and attachments of a session, wherever they lie.

    Args:
        path: of the file, or of one of its parts.

    Attributes:
        paths: of the files, oldest first.
        absent: numbers of parts, counted from 1, that should be there and are not.
        complete: whether everything is there and was closed properly.
        counts: messages of each topic.
        metadata: what the recorder noted; what it noted later replaces what it noted earlier.

    Raises:
        RecordingError: there is no such file, or it is not an MCAP, or it is damaged; another part
            that is so is absent.
    """

    def __init__(self, path: Path) -> None:
        self._files, metadata = _belonging(path)
        self.paths = [file.path for file in self._files]
        numbers = {one.get("part", 1) for one in metadata}
        self.absent = sorted(set(range(1, max(numbers))) - numbers)
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


def _belonging(path: Path) -> tuple[list[McapFile], list[dict[str, Any]]]:
    """The files that belong to the session of one of them, oldest first, and their metadata.

    Others may be named like its parts without being any, nor recordings at all.
    """
    files, parts = [], parts_of(path)
    wanted = path if path in parts else parts[0]
    for part in parts:
        with nullcontext() if part == wanted else suppress(RecordingError):
            files.append(McapFile(part))
    metadata = [_metadata(file) for file in files]
    given = next((i for i, file in enumerate(files) if file.path == path), 0)
    session_id = metadata[given].get("session_id")
    ours = [
        i
        for i, one in enumerate(metadata)
        if i == given or (session_id is not None and one.get("session_id") == session_id)
    ]
    return [files[i] for i in ours], [metadata[i] for i in ours]


def _metadata(file: McapFile) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for record in file.metadata:
        if record.name == METADATA_NAME:
            values |= metadata_from_strings(record.metadata)
    return values
