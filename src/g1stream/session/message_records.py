"""Message records, made of arrays and read as arrays, a batch at a time.

The stock writer and reader take message after message. Where the messages of a channel are all of
one size, their records are the rows of one array instead: heads and messages are put in by column.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from g1stream.session.records import RECORD_HEAD, records_in
from g1stream.session.source import Messages

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    Payloads = Sequence[bytes] | NDArray[np.uint8]

__all__ = [
    "Rows",
    "interleaved",
    "message_places",
    "message_records",
    "messages_at",
]

_HEAD: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
"""A message record without its data: 22 bytes of fields behind opcode and length."""


class Rows(NamedTuple):
    """Messages of one channel and one size, to be written.

    Attributes:
        channel: its number.
        data: (T, size) uint8, a message in each row.
        sequence: number of the first of them.
    """

    channel: int
    data: NDArray[np.uint8]
    sequence: int


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
    sizes = _sizes(payloads)
    heads = _heads(channel, sequence, sizes, log_times, publish_times)
    offsets = np.cumsum(_HEAD.itemsize + sizes) - _HEAD.itemsize - sizes
    if len(sizes) and (sizes == sizes[0]).all():
        bodies = _matrix(payloads)
        rows = np.empty((len(heads), _HEAD.itemsize + bodies.shape[1]), dtype=np.uint8)
        _fill(rows, heads, bodies)
        return rows.tobytes(), offsets
    raw = heads.tobytes()
    size = _HEAD.itemsize
    pieces = (raw[i * size : (i + 1) * size] + bytes(p) for i, p in enumerate(payloads))
    return b"".join(pieces), offsets


def interleaved(
    messages: Sequence[Rows], stamps_ns: NDArray[np.int64]
) -> tuple[NDArray[np.uint8], dict[int, int]]:
    """The records of several channels that have a message each at every time.

    Args:
        messages: of each channel, T messages.
        stamps_ns: (T,) both log and publish time, ns since the epoch.

    Returns:
        (T, width) uint8 the records of each time, in the order of the channels, and where in a row
        each channel's record begins.
    """
    width = sum(_HEAD.itemsize + data.shape[1] for _, data, _ in messages)
    rows = np.empty((len(stamps_ns), width), dtype=np.uint8)
    places: dict[int, int] = {}
    place = 0
    for channel, data, sequence in messages:
        sizes = np.full(len(stamps_ns), data.shape[1])
        end = place + _HEAD.itemsize + data.shape[1]
        heads = _heads(channel, sequence, sizes, stamps_ns, stamps_ns)
        _fill(rows[:, place:end], heads, data)
        places[channel] = place
        place = end
    return rows, places


def message_places(data: bytes) -> dict[int, NDArray[np.int64]]:
    """By channel, (N,) where in an unpacked chunk its messages are, without an index."""
    found: dict[int, list[int]] = {}
    for record in records_in(data):
        if record.opcode == Opcode.MESSAGE:
            channel = int.from_bytes(data[record.place : record.place + 2], "little")
            found.setdefault(channel, []).append(record.place - RECORD_HEAD.size)
    return {channel: np.array(places, dtype=np.int64) for channel, places in found.items()}


def messages_at(data: bytes, places: NDArray[np.int64], channel: int) -> Messages:
    """The messages of a channel in an unpacked chunk, from where they are (N,).

    Raises:
        ValueError: one of them is not there.
    """
    size, head = len(data), _HEAD.itemsize
    if ((places < 0) | (places + head > size)).any():
        raise ValueError("the index of a chunk points outside of it")
    octets = np.frombuffer(data, np.uint8)
    heads = octets[places[:, np.newaxis] + np.arange(head)].view(_HEAD)[:, 0]
    ends = places + RECORD_HEAD.size + np.clip(heads["length"], 0, size)
    wrong = (heads["opcode"] != Opcode.MESSAGE) | (heads["channel"] != channel)
    if (wrong | (ends < places + head) | (ends > size)).any():
        raise ValueError("the index of a chunk points to something else than a message")
    bounds = zip((places + head).tolist(), ends.tolist(), strict=True)
    return Messages(
        np.ascontiguousarray(heads["log_time"]),
        np.ascontiguousarray(heads["publish_time"]),
        [data[start:end] for start, end in bounds],
    )


def _heads(
    channel: int,
    sequence: int,
    sizes: NDArray[np.int64],
    log_times: ArrayLike,
    publish_times: ArrayLike,
) -> NDArray[np.void]:
    """(T,) what is before the data of messages of some sizes (T,)."""
    heads = np.empty(len(sizes), _HEAD)
    heads["opcode"] = Opcode.MESSAGE
    heads["length"] = _HEAD.itemsize - RECORD_HEAD.size + sizes
    heads["channel"] = channel
    heads["sequence"] = sequence + np.arange(len(sizes))
    heads["log_time"], heads["publish_time"] = log_times, publish_times
    return heads


def _fill(rows: NDArray[np.uint8], heads: NDArray[np.void], bodies: NDArray[np.uint8]) -> None:
    """Put heads (T,) and bodies (T, size) side by side into rows (T, head + size)."""
    rows[:, : _HEAD.itemsize] = heads.view(np.uint8).reshape(len(heads), -1)
    rows[:, _HEAD.itemsize :] = bodies


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
