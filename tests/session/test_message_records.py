"""Message records made as arrays, against those of mcap's own writer."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Message

from g1stream.session.message_records import message_records

T0 = 1_700_000_000_000_000_000


def stock(channel, sequence, payloads, log_times, publish_times):
    builder, starts = RecordBuilder(), []
    for i, (data, logged, published) in enumerate(
        zip(payloads, log_times, publish_times, strict=True)
    ):
        starts.append(builder.count)
        Message(
            channel_id=channel,
            sequence=sequence + i,
            log_time=int(logged),
            publish_time=int(published),
            data=bytes(data),
        ).write(builder)
    return builder.end(), starts


@pytest.mark.parametrize(
    "payloads",
    [
        [b"same", b"size"],
        [b"of", b"several", b"", b"sizes"],
        [b"", b""],
        [b"one"],
        np.arange(12, dtype=np.uint8).reshape(3, 4),
    ],
)
def test_they_are_what_the_stock_writer_makes(payloads):
    logged = T0 + np.arange(len(payloads)) * 7
    made, starts = message_records(3, 41, payloads, logged, logged - 5)
    expected, expected_starts = stock(3, 41, payloads, logged, logged - 5)
    assert made == expected
    assert starts.tolist() == expected_starts
