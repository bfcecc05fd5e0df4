"""Message records of an MCAP, a batch at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode

from g1stream.recording.chunks import MESSAGE_HEAD

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Payloads = Sequence[bytes] | NDArray[np.uint8]

__all__ = ["PendingMessages", "message_records"]

#: Opcode and length, which the length itself does not count.
_UNCOUNTED: Final = 9


@dataclass
class PendingMessages:
    """The messages of one channel that wait for their chunk to be closed."""

    records: list[bytes] = field(default_factory=list)
    log_times: list[NDArray[np.int64]] = field(default_factory=list)
    offsets: list[NDArray[np.int64]] = field(default_factory=list)
    size: int = 0

    def add(self, records: bytes, log_times: NDArray[np.int64], offsets: NDArray[np.int64]) -> None:
        """Add what `message_records` made, and the messages' log times."""
        self.records.append(records)
        self.log_times.append(log_times)
        self.offsets.append(self.size + offsets)
        self.size += len(records)


def message_records(
    channel: int,
    sequence: int,
    payloads: Payloads,
    log_times: NDArray[np.int64],
    publish_times: NDArray[np.int64],
) -> tuple[bytes, NDArray[np.int64]]:
    """The records of T messages of one channel.

    Args:
        channel: its number.
        sequence: number of the first of them.
        payloads: (T,) messages, or (T, size) uint8 with one in each row.
        log_times: (T,) ns since the epoch.
        publish_times: (T,) ns since the epoch.

    Returns:
        The records, one behind the other, and (T,) where each begins.
    """
    n = len(payloads)
    sizes = _sizes(payloads)
    heads = np.empty(n, MESSAGE_HEAD)
    heads["opcode"] = Opcode.MESSAGE
    heads["length"] = MESSAGE_HEAD.itemsize - _UNCOUNTED + sizes
    heads["channel"] = channel
    heads["sequence"] = sequence + np.arange(n)
    heads["log_time"], heads["publish_time"] = log_times, publish_times
    offsets = np.cumsum(MESSAGE_HEAD.itemsize + sizes) - MESSAGE_HEAD.itemsize - sizes
    if n and (sizes == sizes[0]).all():
        return _rows(heads, _matrix(payloads)).tobytes(), offsets
    raw = heads.tobytes()
    size = MESSAGE_HEAD.itemsize
    pieces = (raw[i * size : (i + 1) * size] + bytes(p) for i, p in enumerate(payloads))
    return b"".join(pieces), offsets


def _sizes(payloads: Payloads) -> NDArray[np.int64]:
    """(T,) the length of each message."""
    if isinstance(payloads, np.ndarray):
        return np.full(len(payloads), payloads.shape[1], dtype=np.int64)
    return np.fromiter(map(len, payloads), np.int64, len(payloads))


def _matrix(payloads: Payloads) -> NDArray[np.uint8]:
    """(T, size) messages of one size."""
    if isinstance(payloads, np.ndarray):
        return payloads
    return np.frombuffer(b"".join(payloads), np.uint8).reshape(len(payloads), len(payloads[0]))


def _rows(heads: NDArray[np.void], bodies: NDArray[np.uint8]) -> NDArray[np.uint8]:
    rows = np.empty((len(heads), MESSAGE_HEAD.itemsize + bodies.shape[1]), dtype=np.uint8)
    rows[:, : MESSAGE_HEAD.itemsize] = heads.view(np.uint8).reshape(len(heads), -1)
    rows[:, MESSAGE_HEAD.itemsize :] = bodies
    return rows
