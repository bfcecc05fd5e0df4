"""The index behind a chunk, against mcap's own record."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import MessageIndex

from g1stream.session.message_index import ChunkPlace, message_index
from g1stream.session.records import Record

T0 = 1_700_000_000_000_000_000
HEAD = 9


@pytest.mark.parametrize("count", [0, 1, 3])
def test_it_is_what_the_stock_writer_makes(count):
    times, places = T0 + np.arange(count) * 7, 100 + np.arange(count) * 41
    builder = RecordBuilder()
    MessageIndex(5, list(zip(times.tolist(), places.tolist(), strict=True))).write(builder)
    assert message_index(5, times, places) == builder.end()


@pytest.fixture
def behind_a_chunk(tmp_path):
    """A chunk's place with the indexes of two channels noted, and the file that they are in."""
    path = tmp_path / "f"
    indexes = [
        message_index(2, T0 + np.array([3, 1, 2]), np.array([90, 10, 50])),
        message_index(9, T0 + np.array([4]), np.array([70])),
        message_index(4, np.array([], np.int64), np.array([], np.int64)),
    ]
    path.write_bytes(b"".join(indexes))
    with path.open("rb") as file:
        chunk, start = ChunkPlace(Record(6, 0, 0)), 0
        for one in indexes:
            chunk.add_index(file, Record(one[0], start + HEAD, len(one) - HEAD))
            start += len(one)
        yield chunk, file


def test_places_come_in_the_order_of_the_chunk(behind_a_chunk):
    chunk, file = behind_a_chunk
    assert {channel: n for channel, (_, n) in chunk.index.items()} == {2: 3, 9: 1}
    assert chunk.places(file, 2).tolist() == [10, 50, 90]
    assert chunk.places(file, 9).tolist() == [70]


@pytest.mark.parametrize("size", [0, 16, 31, 33, 48])
def test_a_length_that_does_not_fit_is_noticed(tmp_path, size):
    made = bytearray(message_index(2, T0 + np.arange(2), np.arange(2)))
    made[HEAD + 2 : HEAD + 6] = size.to_bytes(4, "little")
    (tmp_path / "f").write_bytes(made)
    with (tmp_path / "f").open("rb") as file, pytest.raises(ValueError, match="another length"):
        ChunkPlace(Record(6, 0, 0)).add_index(file, Record(7, HEAD, len(made) - HEAD))
