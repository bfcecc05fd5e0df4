"""A session written into several files, each of them whole by itself.

Each part carries the attachments and the metadata, and in it `session_id`, which they share, and
`part`, from 1. Sequence numbers go on from part to part.
"""

from __future__ import annotations

import os
import uuid
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from g1stream.errors import RecordingError
from g1stream.session.earlier_parts import earlier_files, remove
from g1stream.session.file_names import part_path
from g1stream.session.writer import SessionWriter

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

__all__ = ["Limits", "PartedWriter"]


@dataclass(frozen=True)
class Limits:
    """When a part ends: with the first chunks that reach one of these.

    Attributes:
        size: bytes, without what every part carries; None: no limit.
        duration: log time, ns; None: no limit.
    """

    size: int | None = None
    duration: int | None = None

    @property
    def any(self) -> bool:
        """Whether there is a limit."""
        return self.size is not None or self.duration is not None


class PartedWriter:
    """Writes a session into one file or, where there are limits, into parts.

    Args:
        path: the session file; the parts are named after it.
        preface: is given the writer of each new part, to say what every part must carry.
        limits: of a part.
        force: replace the file that is there already, or, in parts, one earlier session once the
            first new part is begun; nothing else that has the name of a part.

    Attributes:
        session_id: the same in all parts.
        paths: the files written, oldest first.
        counts: messages taken so far, in all parts, by topic.

    Raises:
        RecordingError: there is a file or a part already, something else has the name of a part, or
            no file can be made there.
    """

    def __init__(
        self,
        path: str | Path,
        preface: Callable[[SessionWriter], None],
        limits: Limits | None = None,
        *,
        force: bool = False,
    ) -> None:
        self.session_id = uuid.uuid4().hex
        self.paths: list[Path] = []
        self.counts: dict[str, int] = {}
        self._path = Path(path)
        self._preface = preface
        self._limits = limits or Limits()
        self._part_start: int | None = None
        if not self._limits.any:
            self._writer = self._next_part(force=force)
        elif old := earlier_files(self._path, force=force):
            self._writer = self._part_instead_of(old)
        else:
            self._writer = self._next_part()

    def __enter__(self) -> PartedWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; see `SessionWriter.write`."""
        self._writer.write(topic, data, log_time, publish_time)

    def write_batch(
        self,
        topic: str,
        payloads: Sequence[bytes] | NDArray[Any],
        log_times: ArrayLike,
        publish_times: ArrayLike,
    ) -> None:
        """Add messages of one topic; see `SessionWriter.write_batch`."""
        self._writer.write_batch(topic, payloads, log_times, publish_times)

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add to the metadata of the part in progress; see `SessionWriter.add_metadata`."""
        self._writer.add_metadata(values)

    def flush_if_due(self, now_ns: int) -> None:
        """Close the chunks, and the part, that time or room has run out for.

        Args:
            now_ns: the time on the clock of the log times, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        self._writer.flush_if_due(now_ns)
        if self._part_start is None:
            self._part_start = now_ns
        if self._is_full(now_ns):
            # First what may fail: without a next part, the last words go into this one.
            self._writer.flush()
            full, self._writer = self._writer, self._next_part()
            self._part_start = now_ns
            full.close()

    def close(self) -> None:
        """Close the part in progress; after that, nothing."""
        self._writer.close()

    def _is_full(self, now_ns: int) -> bool:
        size, duration = self._limits.size, self._limits.duration
        # The distance, not the difference: a clock may be set back.
        elapsed = abs(now_ns - (self._part_start or now_ns))
        return (size is not None and self._writer.size - self._preface_size >= size) or (
            duration is not None and elapsed >= duration
        )

    def _next_part(self, *, force: bool = False) -> SessionWriter:
        number = len(self.paths) + 1
        path = part_path(self._path, number) if self._limits.any else self._path
        writer = self._begin(path, number, force=force)
        self.paths.append(path)
        return writer

    def _part_instead_of(self, old: list[Path]) -> SessionWriter:
        """The first part, which is begun under another name while the old files are there."""
        path = part_path(self._path, 1)
        aside = path.with_name(f".{path.name}.{os.getpid()}.part")
        writer: SessionWriter | None = None
        try:
            writer = self._begin(aside, 1, force=True)
            remove(old)
            writer.rename(path)
        except BaseException:
            if writer is not None:
                with suppress(RecordingError):
                    writer.close()
            with suppress(OSError):
                aside.unlink()
            raise
        self.paths.append(path)
        return writer

    def _begin(self, path: Path, number: int, *, force: bool) -> SessionWriter:
        """A file with what every part carries."""
        counts = dict(self.counts)
        writer = SessionWriter(path, force=force, counts=self.counts)
        try:
            about: dict[str, Any] = {"session_id": self.session_id}
            writer.add_metadata(about | {"part": number} if self._limits.any else about)
            self._preface(writer)
            writer.flush()
        except BaseException:
            with suppress(RecordingError):
                writer.close()
            if number > 1:
                path.unlink(missing_ok=True)
                self.counts.clear()
                self.counts.update(counts)
            raise
        self._preface_size = writer.size
        return writer
