"""A session in several files, each of them whole by itself.

The parts of `session.mcap` are `session_001.mcap`, `session_002.mcap` and so on. Each carries the
attachments and the metadata, and in it `session_id`, which they share, and `part`, from 1. Sequence
numbers go on from part to part.
"""

from __future__ import annotations

import re
import uuid
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from g1stream.container.reader import McapFile
from g1stream.errors import RecordingError
from g1stream.recording.metadata import METADATA_NAME, metadata_from_strings
from g1stream.recording.writer import SessionWriter

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from types import TracebackType

    from numpy.typing import ArrayLike, NDArray

__all__ = ["Limits", "PartedWriter", "parts_of", "timestamped"]

_PART: Final = re.compile(r"(?P<stem>.+)_(?P<number>\d{3,})")


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
        force: replace what is there already.

    Attributes:
        session_id: the same in all parts.
        paths: the files written, oldest first.
        counts: messages taken so far, in all parts, by topic.

    Raises:
        RecordingError: there is a file or a part already, or none can be made there.
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
        self._force = force
        self._part_start: int | None = None
        if self._limits.any:
            self._make_way()
        self._writer = self._next_part()

    def __enter__(self) -> PartedWriter:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; see `SessionWriter.write`."""
        self._writer.write(topic, data, log_time, publish_time)

    def write_batch(
        self,
        topic: str,
        payloads: list[bytes] | NDArray[Any],
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

    def _next_part(self) -> SessionWriter:
        number = len(self.paths) + 1
        path = _part_path(self._path, number) if self._limits.any else self._path
        counts = dict(self.counts)
        writer = SessionWriter(path, force=self._force, counts=self.counts)
        try:
            writer.add_metadata({"session_id": self.session_id, "part": number})
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
        self.paths.append(path)
        self._preface_size = writer.size
        return writer

    def _make_way(self) -> None:
        """Refuse where parts of this name are, or remove them: they would mix with the new.

        Others' files of such names are left alone.
        """
        named = _parts(self._path.parent, self._path.stem, self._path.suffix)
        old = [path for path in named if _is_part(path)]
        if old and not self._force:
            raise RecordingError(
                f"The file {old[0]} exists already.",
                "Choose another name, give --force to replace all its parts, or --auto-name to "
                "add the time.",
            )
        for path in old:
            path.unlink()


def parts_of(path: str | Path) -> list[Path]:
    """The parts that lie beside a part, in order, itself included; or of the name they are after.

    A file that is no part is its own and only one. Whether files belong together is said by the
    `session_id` in their metadata, which is not looked at here.
    """
    path = Path(path)
    match = _PART.fullmatch(path.stem)
    if match and path.exists():
        found = _parts(path.parent, match["stem"], path.suffix)
        return found if path in found else [path]
    return [path] if path.exists() else _parts(path.parent, path.stem, path.suffix) or [path]


def timestamped(path: str | Path, now_ns: int) -> Path:
    """The path with the time, UTC, in its name: `session-20260301T120000Z.mcap`."""
    path = Path(path)
    now = datetime.fromtimestamp(now_ns // 1_000_000_000, timezone.utc)
    return path.with_name(f"{path.stem}-{now:%Y%m%dT%H%M%SZ}{path.suffix}")


def _part_path(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}_{number:03}{path.suffix}")


def _is_part(path: Path) -> bool:
    """Whether a file that is named like a part says itself that it is the part of that number."""
    match = _PART.fullmatch(path.stem)
    try:
        records = McapFile(path).metadata
    except RecordingError:
        return False
    ours = (metadata_from_strings(one.metadata) for one in records if one.name == METADATA_NAME)
    return match is not None and any(one.get("part") == int(match["number"]) for one in ours)


def _parts(directory: Path, stem: str, suffix: str) -> list[Path]:
    """Part 1, 2, ... of a name, as they lie in a directory."""
    found = {}
    for path in directory.iterdir() if directory.is_dir() else ():
        match = _PART.fullmatch(path.stem)
        if path.suffix == suffix and match and match["stem"] == stem:
            found[int(match["number"])] = path
    return [found[number] for number in sorted(found)]
