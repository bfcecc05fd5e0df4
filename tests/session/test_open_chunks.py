"""Messages that wait for their chunks."""

from __future__ import annotations

import numpy as np

from g1stream.session.message_records import message_records
from g1stream.session.open_chunks import OpenChunks

T0 = 1_700_000_000_000_000_000


def test_batches_that_wait_lie_one_behind_the_other():
    chunks = OpenChunks(span_ns=10)
    times = np.array([T0, T0 + 1])
    for payloads in ([b"a", b"bc"], [b"def", b""]):
        records, starts = message_records(1, 1, payloads, times, times)
        chunks.of("/a").add(records, times, starts)
    waiting = chunks.size
    pending = chunks.take()["/a"]
    records, log_times, offsets = pending.joined()
    assert len(records) == pending.size == waiting
    assert [records[start] for start in offsets] == [5, 5, 5, 5]
    assert log_times.tolist() == [*times, *times]
    assert len(pending) == 4
    assert chunks.size == 0


def test_the_first_time_asked_for_opens_the_chunks_and_taking_them_ends_that():
    chunks = OpenChunks(span_ns=10)
    assert chunks.room_for(T0 + np.array([0, 9, 10, 9])) == 2
    assert chunks.room_for(T0 + np.array([10])) == 0
    assert chunks.room_for(T0 - np.array([9, 10])) == 1  # a clock that was set back
    assert chunks.take() == {}
    assert chunks.room_for(T0 + np.array([10, 19])) == 2
