"""Writes a session file of messages that are known beforehand.

The file grows under another name and takes its own when it is whole.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from g1stream._version import __version__
from g1stream.errors import RecordingError
from g1stream.session.chunked_file import ChunkedFile
from g1stream.session.message_records import Rows
from g1stream.session.metadata import METADATA_NAME, metadata_to_strings
from g1stream.session.output_path import check_free

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from types import TracebackType

    import numpy as np
    from numpy.typing import NDArray

    from g1stream.session.compression import Compression
    from g1stream.session.format import Channel

__all__ = ["OfflineWriter"]


class OfflineWriter:
    """A session file being made; a context manager.

    Leaving the context finishes the file and gives it its name; leaving it on an exception, Ctrl-C
    included, removes what there is.

    Args:
        path: where to; its directory must exist.
        force: replace a file that is there already.
        compression: of the chunks.

    Attributes:
        path: where to.
        counts: messages written so far, by topic.

    Raises:
        RecordingError: there is a file already, or none can be made there.
    """

    def __init__(
        self, path: str | Path, *, force: bool = False, compression: Compression = "zstd"
    ) -> None:
        self.path = Path(path)
        self.counts: dict[str, int] = {}
        self._force = force
        check_free(self.path, force=force)
        self._part = self.path.with_name(f".{self.path.name}.{os.getpid()}.part")
        with self._os_errors():
            self._stream = self._part.open("wb")
            try:
                self._file = ChunkedFile(self._stream, f"g1stream {__version__}", compression)
            except BaseException:
                self._part.unlink(missing_ok=True)
                raise

    def __enter__(self) -> OfflineWriter:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            with self._os_errors():
                if exc_type is None:
                    self._finish()
                self._stream.close()
        finally:
            self._part.unlink(missing_ok=True)

    def add_channel(self, channel: Channel) -> None:
        """Add a channel; the next chunk describes it."""
        self._file.registry.number(channel)
        self.counts[channel.topic] = 0

    def write(
        self, messages: Mapping[str, NDArray[np.uint8]], stamps_ns: NDArray[np.int64]
    ) -> None:
        """Add a chunk: at each time a message of every topic named; they count from 1.

        Args:
            messages: by topic, (T, size) with a message in each row; T > 0.
            stamps_ns: (T,) both log and publish time, ns since the epoch, rising.

        Raises:
            RecordingError: the file cannot be written any more.
        """
        channels = self._file.registry.channels
        rows = [
            Rows(channels[topic].id, data, self.counts[topic] + 1)
            for topic, data in messages.items()
        ]
        with self._os_errors():
            self._file.write_rows(rows, stamps_ns)
        for topic in messages:
            self.counts[topic] += len(stamps_ns)

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file, such as the URDF.

        Args:
            name: what to call it.
            media_type: such as `text/csv`.
            data: its content.
            time_ns: when it was there, ns since the epoch.

        Raises:
            RecordingError: the file cannot be written any more.
        """
        with self._os_errors():
            self._file.attach(name, media_type, data, time_ns)

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add to the session's metadata anything that JSON can say.

        Raises:
            RecordingError: the file cannot be written any more.
            TypeError: a value is something else.
        """
        with self._os_errors():
            self._file.add_metadata(METADATA_NAME, metadata_to_strings(values))

    def _finish(self) -> None:
        self._file.finish()
        self._stream.close()
        check_free(self.path, force=self._force)
        self._part.replace(self.path.resolve())

    @contextmanager
    def _os_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise RecordingError(
                f"The file {self.path} cannot be written: {error.strerror}.",
                "Make room, or choose another place for it.",
            ) from error
