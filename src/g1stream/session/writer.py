"""Writes a session as it happens: into one file, or into a directory of parts.

Messages wait for a quarter of a second of log time and are then written, a chunk for each topic;
that much at most is lost when the program is killed.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from g1stream.errors import RecordingError
from g1stream.session.format import CHANNELS
from g1stream.session.mcap_writer import McapWriter, MessageBatch
from g1stream.session.parts import (
    Part,
    check_recording_path,
    new_directory,
    part_path,
    parts_directory,
    write_metadata_yaml,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from g1stream.session.format import Channel
    from g1stream.session.mcap_writer import Compression

__all__ = ["SessionWriter", "SplitLimits"]

_CHUNK_NS: Final = 250_000_000
_NEVER: Final = 2**63 - 1

# Chunks are written by time; by size only if something floods the file.
_CHUNK_BYTES: Final = 32 * 2**20


@dataclass(frozen=True)
class SplitLimits:
    """When a part of a recording ends: with the first chunks that reach one of these.

    Attributes:
        size: bytes, without the file header that every part has; None: no limit.
        duration: log time, ns; None: no limit.
    """

    size: int | None = None
    duration: int | None = None

    @property
    def any(self) -> bool:
        """Whether there is a limit."""
        return self.size is not None or self.duration is not None


class SessionWriter:
    """A session being written; a context manager.

    Leaving the context closes the file properly even on an exception or Ctrl-C. So does a full
    disk: what did not fit is dropped, and there is room for the last metadata and the index.

    Args:
        path: of the file; its directory must exist. Parts go into a directory called after it.
        force: replace a file that is there, or a directory that g1stream recorded.
        limits: of a part; one file if None.
        file_header: called at the start of each file to write what every part must have.
        channels: those that messages may be written to, by topic.
        chunk_ns: write the chunks when this much log time has passed, ns; if None, on `flush` only.
        compression: of the chunks.

    Attributes:
        path: the file, or the directory of the parts.
        paths: the files written, oldest first.
        counts: messages taken so far, in all parts, by topic.

    Raises:
        RecordingError: something is there that may not be replaced, or nothing can be written.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        force: bool = False,
        limits: SplitLimits | None = None,
        file_header: Callable[[SessionWriter], None] = lambda _: None,
        channels: Mapping[str, Channel] = CHANNELS,
        chunk_ns: int | None = _CHUNK_NS,
        compression: Compression = "zstd",
    ) -> None:
        self._limits = limits or SplitLimits()
        self._file_header = file_header
        self._channels = channels
        self._chunk_ns = chunk_ns or _NEVER
        self._compression = compression
        self._pending: dict[str, list[MessageBatch]] = {}
        self._pending_bytes = 0
        self._chunk_start: int | None = None
        self._part_start: int | None = None
        self._parts: list[Part] = []
        self._closed = False
        self.counts: dict[str, int] = {}
        self.path = parts_directory(Path(path)) if self._limits.any else Path(path)
        check_recording_path(Path(path), split=self._limits.any, force=force)
        if not self._limits.any:
            self.paths = [self.path]
            self._file = self._open_file(self.path, force=force)
            return
        self.paths = [part_path(self.path, 0)]
        with new_directory(self.path) as temporary:
            self._file = self._open_file(temporary / self.paths[0].name)
            write_metadata_yaml(temporary, [self._part()], channels)
        self._file.path = self.paths[0]

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; its sequence number counts the topic's messages from 1.

        Args:
            topic: of one of the channels.
            data: the message in the encoding of its channel.
            log_time: when it was received, ns since the epoch.
            publish_time: when its producer published it, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        self.write_batch(topic, (data,), (log_time,), (publish_time,))

    def write_batch(
        self,
        topic: str,
        payloads: Sequence[bytes] | NDArray[np.uint8],
        log_times: ArrayLike,
        publish_times: ArrayLike,
    ) -> None:
        """Add messages of one topic, oldest first.

        Args:
            topic: of one of the channels.
            payloads: (T,) messages, or (T, size) uint8 with one in each row.
            log_times: (T,) when they were received, ns since the epoch.
            publish_times: (T,) when their producer published them, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
            ValueError: the lengths differ.
        """
        logged = np.asarray(log_times, dtype=np.int64)
        published = np.asarray(publish_times, dtype=np.int64)
        if not len(payloads) == len(logged) == len(published):
            raise ValueError(
                f"{len(payloads)} payloads with {len(logged)} log times and {len(published)} "
                "publish times"
            )
        start = 0
        while start < len(logged):
            if self._is_due(int(logged[start])):
                self.flush()
            if self._chunk_start is None:
                self._chunk_start = int(logged[start])
            # The distance, not the difference: a clock may be set back.
            late = np.abs(logged[start:] - self._chunk_start) >= self._chunk_ns
            end = start + (int(late.argmax()) if late.any() else len(late))
            part = slice(start, end)
            count = self.counts.get(topic, 0)
            batch = MessageBatch(payloads[part], logged[part], published[part], count + 1)
            self._pending.setdefault(topic, []).append(batch)
            self.counts[topic] = count + end - start
            self._pending_bytes += batch.size
            if self._pending_bytes > _CHUNK_BYTES:
                self.flush()
            start = end

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file, such as the URDF.

        Args:
            name: what to call it, such as `g1.urdf`.
            media_type: such as `text/csv`.
            data: its content.
            time_ns: when it was there, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        self._file.attach(name, media_type, data, time_ns)

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add to the session's metadata; a later value of a key replaces an earlier one.

        Args:
            values: anything that JSON can say, and numpy arrays.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
            TypeError: a value is something else.
        """
        self._file.add_metadata(values)

    def flush_if_due(self, now_ns: int) -> None:
        """Write the chunks that are due, and go on in the next part if this one is full.

        Args:
            now_ns: the time on the clock of the log times, ns since the epoch.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        if self._is_due(now_ns):
            self.flush()
        if self._part_start is None:
            self._part_start = now_ns
        if self._is_part_full(now_ns):
            self._start_next_part()
            self._part_start = now_ns

    def flush(self, *, last: bool = False) -> None:
        """Write the messages that wait; what does not fit on the disk is dropped.

        Args:
            last: whether the space that is kept for the end of a file may be used.

        Raises:
            RecordingError: the disk is full, or the file cannot be written for another reason.
        """
        pending, self._pending = self._pending, {}
        self._pending_bytes, self._chunk_start = 0, None
        try:
            for topic in list(pending):
                self._file.write_chunk(topic, pending[topic], last=last)
                del pending[topic]
        finally:
            for topic, dropped in pending.items():
                self.counts[topic] -= sum(len(batch.payloads) for batch in dropped)

    def close(self) -> None:
        """Write what waits and the index, and close the file; once is enough.

        Raises:
            RecordingError: that failed; the file reads up to its last whole chunk.
        """
        if self._closed:
            return
        self._closed = True
        try:
            self.flush(last=True)
        finally:
            self._file.close()
            if self._limits.any:
                with suppress(RecordingError):  # the one written with the last part lists them all
                    self._write_metadata_yaml()

    def _is_due(self, now_ns: int) -> bool:
        return self._chunk_start is not None and abs(now_ns - self._chunk_start) >= self._chunk_ns

    def _is_part_full(self, now_ns: int) -> bool:
        size, duration = self._limits.size, self._limits.duration
        elapsed = abs(now_ns - (self._part_start or now_ns))
        return (size is not None and self._file.size - self._header_size >= size) or (
            duration is not None and elapsed >= duration
        )

    def _open_file(self, path: Path, *, force: bool = False) -> McapWriter:
        """Start a file with what every part has; while that is written, it is the current one."""
        file = McapWriter(path, self._channels, force=force, compression=self._compression)
        self._file = file
        try:
            if self._limits.any:
                file.add_metadata({"part": len(self._parts)})
            self._file_header(self)
            self.flush()
        except BaseException:
            with suppress(RecordingError):
                file.close()
            raise
        self._header_size = file.size
        return file

    def _start_next_part(self) -> None:
        """Go on in a new file; if none can be started, the current one stays in use."""
        self.flush()
        full, counts = self._file, dict(self.counts)
        path = part_path(self.path, len(self.paths))
        self._parts.append(self._part())
        try:
            self._open_file(path)
            self.paths.append(path)
            self._write_metadata_yaml()
        except BaseException:
            self._parts.pop()
            self._file, self.counts, self.paths = full, counts, self.paths[: len(self._parts) + 1]
            self._pending, self._pending_bytes, self._chunk_start = {}, 0, None
            path.unlink(missing_ok=True)
            raise
        full.close()

    def _part(self) -> Part:
        """The file in progress, as metadata.yaml lists it."""
        file = self._file
        return Part(file.path.name, dict(file.counts), file.first_log_time, file.last_log_time)

    def _write_metadata_yaml(self) -> None:
        write_metadata_yaml(self.path, [*self._parts, self._part()], self._channels)
