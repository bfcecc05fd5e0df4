"""Messages that wait for their chunks to be closed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["OpenChunks", "PendingMessages"]


@dataclass
class PendingMessages:
    """The messages of one channel that wait for their chunk to be closed.

    Attributes:
        records: their records, a batch each.
        log_times: (T,) int64 ns since the epoch, of each batch.
        offsets: (T,) int64 where they begin in all records joined, of each batch.
        size: bytes of all records.
    """

    records: list[bytes] = field(default_factory=list)
    log_times: list[NDArray[np.int64]] = field(default_factory=list)
    offsets: list[NDArray[np.int64]] = field(default_factory=list)
    size: int = 0

    def __len__(self) -> int:
        return sum(map(len, self.log_times))

    def add(self, records: bytes, log_times: NDArray[np.int64], offsets: NDArray[np.int64]) -> None:
        """Add what `message_records` made, and the messages' log times."""
        self.records.append(records)
        self.log_times.append(log_times)
        self.offsets.append(self.size + offsets)
        self.size += len(records)

    def joined(self) -> tuple[bytes, NDArray[np.int64], NDArray[np.int64]]:
        """All records, and of their messages (T,) log times, ns, and (T,) offsets in them."""
        return b"".join(self.records), np.concatenate(self.log_times), np.concatenate(self.offsets)


class OpenChunks:
    """The chunks that are open, one for each topic; they are closed together.

    Args:
        span_ns: how much log time they may span, ns.

    Attributes:
        pending: what they hold, by topic.
    """

    def __init__(self, span_ns: int) -> None:
        self.pending: dict[str, PendingMessages] = {}
        self._span_ns = span_ns
        self._start: int | None = None

    @property
    def size(self) -> int:
        """Bytes of all that waits."""
        return sum(messages.size for messages in self.pending.values())

    def room_for(self, log_times: NDArray[np.int64]) -> int:
        """How many of the (T,) messages, oldest first, still go into the open chunks.

        The first ever asked for sets when they begin; 0 means that they are to be closed first.
        """
        if self._start is None:
            self._start = int(log_times[0])
        # The distance, not the difference: a clock may be set back.
        fits = np.abs(log_times - self._start) < self._span_ns
        return len(fits) if fits.all() else int(fits.argmin())

    def of(self, topic: str) -> PendingMessages:
        """What waits on a topic, to be added to."""
        return self.pending.setdefault(topic, PendingMessages())

    def take(self) -> dict[str, PendingMessages]:
        """All that waits, by topic; the chunks opened next are empty and begin anew."""
        taken, self.pending, self._start = self.pending, {}, None
        return taken
