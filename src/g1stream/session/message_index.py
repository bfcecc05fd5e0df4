"""The index behind a chunk: by channel, the time of each message and where in the chunk it is."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode

from g1stream.session.records import RECORD_HEAD, read_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from g1stream.session.records import Record

__all__ = ["ChunkPlace", "message_index"]

#: The channel, and how many bytes of entries follow.
_HEAD: Final = struct.Struct("<HI")
_ENTRY: Final = np.dtype([("log_time", "<i8"), ("place", "<i8")])


def message_index(channel: int, log_times: NDArray[np.int64], places: NDArray[np.int64]) -> bytes:
    """The MessageIndex record of a channel.

    Args:
        channel: its number.
        log_times: (T,) of its messages, ns since the epoch.
        places: (T,) where in the unpacked chunk their records begin.
    """
    entries = np.empty(len(places), _ENTRY)
    entries["log_time"], entries["place"] = log_times, places
    head = _HEAD.pack(channel, entries.nbytes)
    return (
        RECORD_HEAD.pack(Opcode.MESSAGE_INDEX, len(head) + entries.nbytes)
        + head
        + entries.tobytes()
    )


@dataclass
class ChunkPlace:
    """Where a chunk is, and the index behind it: by channel, where its entries are and how many.

    A chunk without an index has to be walked through to know what is in it.
    """

    record: Record
    index: dict[int, tuple[int, int]] = field(default_factory=dict)

    def add_index(self, file: IO[bytes], record: Record) -> None:
        """Note a MessageIndex record that follows the chunk.

        Raises:
            ValueError: it is damaged.
        """
        channel, size = _HEAD.unpack(read_at(file, record.place, _HEAD.size))
        n_entries, rest = divmod(size, _ENTRY.itemsize)
        if rest or size != record.length - _HEAD.size:
            raise ValueError("the index of a chunk has another length than it says")
        if n_entries:
            self.index[channel] = (record.place + _HEAD.size, n_entries)

    def places(self, file: IO[bytes], channel: int) -> NDArray[np.int64]:
        """(N,) where in the unpacked chunk the messages of a channel are, as the index says."""
        start, n_entries = self.index[channel]
        entries = np.frombuffer(read_at(file, start, n_entries * _ENTRY.itemsize), _ENTRY)
        return np.sort(entries["place"])
