"""Where a `Session` reads from: files on disk, or messages collected in memory.

`Session` needs nothing but a `SessionSource`. `SessionFiles` reads one from disk; `MemorySource`
below serves what was written into it, so that a run in lockstep gives a Session without a file:

    source = MemorySource("rollout")
    source.add_metadata({"motion": {"name": "walk"}})
    source.write("/lowstate", sample, log_time, publish_time)
    session = Session(source)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np

from g1stream.session.format import metadata_from_strings, metadata_to_strings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

__all__ = ["MemorySource", "Messages", "SessionSource", "Slices"]


class Messages(NamedTuple):
    """Messages of one topic, in the order in which they were written.

    Attributes:
        log_times: (N,) int64, when each was received, ns since the epoch.
        publish_times: (N,) int64, when each was published, ns since the epoch.
        data: the N messages, in the encoding of their channel.
    """

    log_times: NDArray[np.int64]
    publish_times: NDArray[np.int64]
    data: Sequence[bytes]


class Slices(Sequence[bytes]):
    """Messages as slices of the chunk that they are in, made when they are asked for.

    Args:
        chunk: decompressed.
        starts, ends: (N,) where in it each message is.
    """

    def __init__(
        self, chunk: bytes | memoryview, starts: NDArray[np.int64], ends: NDArray[np.int64]
    ) -> None:
        self._chunk, self._starts, self._ends = chunk, starts, ends

    def __len__(self) -> int:
        return len(self._starts)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> Slices: ...
    def __getitem__(self, index: int | slice) -> bytes | Slices:
        if isinstance(index, slice):
            return Slices(self._chunk, self._starts[index], self._ends[index])
        return bytes(self._chunk[self._starts[index] : self._ends[index]])

    def __iter__(self) -> Iterator[bytes]:
        bounds = zip(self._starts.tolist(), self._ends.tolist(), strict=True)
        return (bytes(self._chunk[start:end]) for start, end in bounds)

    def rows(self) -> NDArray[np.uint8] | None:
        """(N, size) a view of messages of one size at even distances; None where they are not."""
        sizes = self._ends - self._starts
        step = int(self._starts[1] - self._starts[0]) if len(self) > 1 else len(self._chunk)
        even = (np.diff(self._starts) == step).all() and (sizes == sizes[:1]).all()
        if not len(self) or not even or step < sizes[0]:
            return None
        found: NDArray[np.uint8] = np.ndarray(
            (len(self), int(sizes[0])), np.uint8, self._chunk, int(self._starts[0]), (step, 1)
        )
        return found


class SessionSource(ABC):
    """The messages, metadata and attachments of one session.

    Attributes:
        path: the file or directory; of a session in memory only a name for error messages.
        paths: the files it was read from, oldest first; empty in memory.
        topics: number of messages by topic.
        metadata: the values of all metadata records; a later one replaces an earlier one.
        complete: whether all parts are there and were closed properly.
        absent_parts: by number, as in their names, of the parts that are missing or cannot be
            read: why, a sentence.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.paths: list[Path] = []
        self.topics: dict[str, int] = {}
        self.metadata: dict[str, Any] = {}
        self.complete = True
        self.absent_parts: dict[int, str] = {}

    @abstractmethod
    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, batch by batch; the batches of a topic are in order.

        Raises:
            RecordingError: the file is damaged.
        """

    @abstractmethod
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name.

        Raises:
            RecordingError: the file is damaged.
        """


class MemorySource(SessionSource):
    """A session in memory: written like a file with `SessionWriter`, read as a `SessionSource`.

    Args:
        name: shown where a file's path would be, as in error messages.
    """

    def __init__(self, name: str = "memory") -> None:
        super().__init__(Path(name))
        self._messages: dict[str, list[tuple[int, int, bytes]]] = {}
        self._attachments: dict[str, bytes] = {}

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Add one message; times in ns since the epoch."""
        self._messages.setdefault(topic, []).append((log_time, publish_time, data))
        self.topics[topic] = self.topics.get(topic, 0) + 1

    def write_batch(
        self,
        topic: str,
        payloads: Sequence[bytes] | NDArray[np.uint8],
        log_times: ArrayLike,
        publish_times: ArrayLike,
    ) -> None:
        """Add T messages of one topic; see `SessionWriter.write_batch`."""
        times = np.asarray(log_times).tolist(), np.asarray(publish_times).tolist()
        for data, log_time, publish_time in zip(payloads, *times, strict=True):
            self.write(topic, bytes(data), log_time, publish_time)

    def add_metadata(self, values: Mapping[str, Any]) -> None:
        """Add metadata: anything that JSON can say, and numpy arrays, which become lists."""
        self.metadata |= metadata_from_strings(metadata_to_strings(values))

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file; media type and time are what a file on disk would say of it."""
        self._attachments[name] = data

    def batches(self, topics: set[str]) -> Iterator[tuple[str, Messages]]:
        """The messages of some topics, one batch for each topic."""
        for topic in topics & self._messages.keys():
            log_times, publish_times, data = zip(*self._messages[topic], strict=True)
            times = np.array(log_times, np.int64), np.array(publish_times, np.int64)
            yield topic, Messages(*times, list(data))

    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return dict(self._attachments)
