"""Writes a session file as it happens, so that it can be read whatever ends the recorder.

An MCAP is a row of chunks, each compressed on its own. One is closed and handed to the operating
system for every quarter of a second of log time, so that a killed recorder loses less than that
much and its file reads up to the last whole chunk. A file that was closed has an index as well.
"""

from __future__ import annotations

from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np
from mcap.writer import CompressionType, Writer

from g1stream._version import __version__
from g1stream.errors import RecordingError
from g1stream.recording.channels import CHANNELS
from g1stream.recording.metadata import METADATA_NAME, metadata_to_strings

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from types import TracebackType

    from numpy.typing import ArrayLike, NDArray

__all__ = ["SessionWriter"]

_CHUNK_NS: Final = 250_000_000

# Chunks are closed by time; by size only if something floods the file.
_CHUNK_BYTES: Final = 32 * 2**20


class SessionWriter:
    """A session file being written; a context manager.

    Leaving the context closes the file properly even on an exception or Ctrl-C.

    Args:
        path: where to; its directory must exist.
        force: replace a file that is there already.
        chunk_ns: close a chunk when this much log time has passed, ns.

    Attributes:
        path: where to.
        counts: messages written so far, by topic.

    Raises:
        RecordingError: there is a file already, or none can be made there.
    """

    def __init__(self, path: str | Path, *, force: bool = False, chunk_ns: int = _CHUNK_NS) -> None:
        self.path = Path(path)
        self.counts: dict[str, int] = {}
        self._chunk_ns = chunk_ns
        self._chunk_start: int | None = None
        self._channel_ids: dict[str, int] = {}
        self._schema_ids: dict[str, int] = {}
        self._file = _create(self.path, force)
        self._writer: Any = Writer(self._file, _CHUNK_BYTES, CompressionType.ZSTD)
        with self._os_errors():
            self._writer.start(library=f"g1stream {__version__}")
            self._file.flush()

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; its sequence number counts the topic's messages from 1.

        Args:
            topic: one of `g1stream.recording.channels.CHANNELS`.
            data: the message in the encoding of its channel.
            log_time: when it was received, ns since the epoch.
            publish_time: when its producer published it, ns since the epoch.

        Raises:
            RecordingError: the file cannot be written any more.
        """
        self.write_batch(topic, (data,), (log_time,), (publish_time,))

    def write_batch(
        self,
        topic: str,
        payloads: Iterable[bytes] | NDArray[np.uint8],
        log_times: ArrayLike,
        publish_times: ArrayLike,
    ) -> None:
        """Add messages of one topic, oldest first.

        Args:
            topic: one of `g1stream.recording.channels.CHANNELS`.
            payloads: (T,) messages, or (T, size) uint8 with one in each row.
            log_times: (T,) when they were received, ns since the epoch.
            publish_times: (T,) when their producer published them, ns since the epoch.

        Raises:
            RecordingError: the file cannot be written any more.
            ValueError: the lengths differ.
        """
        channel_id = self._channel_id(topic)
        sequence = self.counts.get(topic, 0)
        messages = zip(
            map(bytes, payloads),
            np.asarray(log_times).tolist(),
            np.asarray(publish_times).tolist(),
            strict=True,
        )
        with self._os_errors():
            for data, log_time, publish_time in messages:
                self._close_chunk_before(log_time)
                sequence += 1
                self._writer.add_message(channel_id, log_time, data, publish_time, sequence)
                self.counts[topic] = sequence

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file, such as the URDF.

        Args:
            name: what to call it, such as `g1.urdf`.
            media_type: such as `text/csv`.
            data: its content.
            time_ns: now, ns since the epoch.

        Raises:
            RecordingError: the file cannot be written any more.
        """
        with self._os_errors():
            self._writer.add_attachment(time_ns, time_ns, name, media_type, data)
            self._file.flush()

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add to the session's metadata; a later value of a key replaces an earlier one.

        Args:
            values: anything that JSON can say, and numpy arrays.

        Raises:
            RecordingError: the file cannot be written any more.
            TypeError: a value is something else.
        """
        with self._os_errors():
            self._writer.add_metadata(METADATA_NAME, metadata_to_strings(values))
            self._file.flush()

    def flush_if_due(self, now_ns: int) -> None:
        """Close the chunk that time has run out for, when no message comes to do it.

        Args:
            now_ns: the time on the clock of the log times, ns since the epoch.

        Raises:
            RecordingError: the file cannot be written any more.
        """
        with self._os_errors():
            self._close_chunk_before(now_ns)

    def close(self) -> None:
        """Write the index and close the file; after that, nothing.

        Raises:
            RecordingError: that failed; the file reads up to its last whole chunk.
        """
        if self._file.closed:
            return
        with self._os_errors():
            self._writer.finish()
            self._file.close()

    def _close_chunk_before(self, log_time: int) -> None:
        """Close the chunk in progress if, with this time in it, it would span too much."""
        if self._chunk_start is None:
            self._chunk_start = log_time
        # The distance, not the difference: a clock may be set back.
        elif abs(log_time - self._chunk_start) >= self._chunk_ns:
            self._writer.flush()
            self._chunk_start = log_time

    def _channel_id(self, topic: str) -> int:
        known = self._channel_ids.get(topic)
        if known is not None:
            return known
        channel = CHANNELS[topic]
        schema_id = self._schema_ids.get(channel.schema_name)
        if schema_id is None:
            schema_id = self._writer.register_schema(
                channel.schema_name, channel.schema_encoding, channel.build_schema()
            )
            self._schema_ids[channel.schema_name] = schema_id
        self._channel_ids[topic] = self._writer.register_channel(
            topic, channel.message_encoding, schema_id, {"description": channel.description}
        )
        return self._channel_ids[topic]

    @contextmanager
    def _os_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            # At once: nothing may be written behind a chunk that is only half there.
            with suppress(OSError):
                self._file.close()
            raise RecordingError(
                f"The recording {self.path} cannot be written any more: {error.strerror}.",
                "Make room or choose another place; the file reads up to its last whole chunk.",
            ) from error


def _create(path: Path, force: bool) -> IO[bytes]:
    if path.is_dir():
        raise RecordingError(f"{path} is a directory.", "Name a file in it, such as session.mcap.")
    try:
        return path.open("wb" if force else "xb")
    except FileExistsError as error:
        raise RecordingError(
            f"The file {path} exists already.",
            "Choose another name, or give --force to replace it.",
        ) from error
    except FileNotFoundError as error:
        raise RecordingError(
            f"The directory {path.parent} does not exist.", f"Make it: mkdir -p {path.parent}"
        ) from error
    except OSError as error:
        raise RecordingError(
            f"The file {path} cannot be made: {error.strerror}.", "Choose another place for it."
        ) from error
