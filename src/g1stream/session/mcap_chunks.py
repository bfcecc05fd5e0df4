"""The messages in the chunks of an MCAP file, as arrays.

The layout of the records is that of the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode

from g1stream.input_limits import LATEST_NS
from g1stream.session.mcap_records import RECORD_HEAD, Record, read_at, records_in
from g1stream.session.source import Messages, Slices

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Chunk", "message_offsets", "messages_of"]


#: Of a MessageIndex record: the channel, and how many bytes of entries follow.
_INDEX: Final = struct.Struct("<HI")
_INDEX_ENTRY: Final = np.dtype([("log_time", "<i8"), ("offset", "<i8")])
#: A Message record without its data.
_MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)


@dataclass
class Chunk:
    """A chunk and the MessageIndex records behind it; without an index it has to be searched.

    Attributes:
        record: the chunk.
        index: by channel, where the entries of its index are and how many.
    """

    record: Record
    index: dict[int, tuple[int, int]] = field(default_factory=dict)

    def add_index(self, file: IO[bytes], record: Record) -> None:
        channel, size = _INDEX.unpack(read_at(file, record.start, _INDEX.size))
        n_entries, rest = divmod(size, _INDEX_ENTRY.itemsize)
        if rest or size != record.length - _INDEX.size:
            raise ValueError("the index of a chunk has another length than it says")
        if n_entries:
            self.index[channel] = (record.start + _INDEX.size, n_entries)

    @property
    def end(self) -> int:
        """Where in the file its last index ends; the end of its own record without an index."""
        ends = (start + n * _INDEX_ENTRY.itemsize for start, n in self.index.values())
        return max(ends, default=self.record.start + self.record.length)

    def offsets(
        self, content: bytes, records: bytes, channels: set[int]
    ) -> dict[int, NDArray[np.int64]]:
        """By channel, (N,) where in the decompressed chunk its messages are, ascending.

        Args:
            content: of the file, from the start of the record to `end`.
            records: the decompressed chunk.
            channels: those that are wanted.

        Raises:
            ValueError: the index points outside of the chunk.
        """
        if not self.index:
            return {c: found for c, found in message_offsets(records).items() if c in channels}
        found = {}
        for channel in sorted(channels & self.index.keys()):
            start, n_entries = self.index[channel]
            entries = np.frombuffer(content, _INDEX_ENTRY, n_entries, start - self.record.start)
            offsets = np.sort(entries["offset"])
            if offsets[0] < 0 or offsets[-1] + _MESSAGE.itemsize > len(records):
                raise ValueError("the index of a chunk points outside of it")
            found[channel] = offsets
        return found


def message_offsets(data: bytes | memoryview) -> dict[int, NDArray[np.int64]]:
    """By channel, (N,) where in a decompressed chunk its messages are, without an index."""
    found: dict[int, list[int]] = {}
    for record in records_in(data):
        if record.opcode == Opcode.MESSAGE:
            channel = int.from_bytes(data[record.start : record.start + 2], "little")
            found.setdefault(channel, []).append(record.start - RECORD_HEAD.size)
    return {channel: np.array(offsets, dtype=np.int64) for channel, offsets in found.items()}


def messages_of(
    records: list[bytes], offsets: list[dict[int, NDArray[np.int64]]]
) -> dict[int, Messages]:
    """By channel, the messages of some decompressed chunks, from where they are in each."""
    data: bytes | memoryview = records[0]
    if len(records) > 1:
        # Unlike joined bytes, without the interpreter's lock: other threads do not wait for it.
        data = np.concatenate([np.frombuffer(one, np.uint8) for one in records]).data
    ends = np.cumsum([len(one) for one in records])
    starts = np.concatenate([[0], ends[:-1]])
    found = {}
    for channel in offsets[0]:
        in_chunks = [one[channel] for one in offsets]
        where = np.concatenate([at + start for at, start in zip(in_chunks, starts, strict=True)])
        limits = np.repeat(ends, [len(at) for at in in_chunks])
        found[channel] = _messages_at(data, where, limits, channel)
    return found


def _messages_at(
    data: bytes | memoryview, offsets: NDArray[np.int64], limits: NDArray[np.int64], channel: int
) -> Messages:
    """The messages of a channel, from where their records are (N,), and where their chunks end."""
    size, head = len(data), _MESSAGE.itemsize
    steps = offsets[1:] - offsets[:-1]
    step = int(steps[0]) if len(steps) else head
    if step > 0 and (steps == step).all():  # samples of DDS are of one size
        heads = np.ndarray(len(offsets), _MESSAGE, data, int(offsets[0]), (step,))
    else:
        octets = np.frombuffer(data, np.uint8)
        heads = octets[offsets[:, np.newaxis] + np.arange(head)].view(_MESSAGE)[:, 0]
    lengths = np.ascontiguousarray(heads["length"])
    starts, ends = offsets + head, offsets + (RECORD_HEAD.size + lengths.clip(0, size))
    wrong = (heads["opcode"] != Opcode.MESSAGE) | (heads["channel"] != channel)
    if (wrong | (ends < starts) | (ends > limits)).any():
        raise ValueError("the index of a chunk points to something else than a message")
    times = (np.ascontiguousarray(heads["log_time"]), np.ascontiguousarray(heads["publish_time"]))
    if any(one.min() < 0 or one.max() >= LATEST_NS for one in times):
        raise ValueError("a message has a time after 2116")
    return Messages(*times, Slices(data, starts, ends))
