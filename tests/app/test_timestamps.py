from datetime import datetime, timedelta, timezone
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from g1stream.app.convert import frame_timestamps, parse_time
from g1stream.errors import ConfigError


@given(
    st.integers(0, 10**18),
    st.integers(0, 10**8),
    st.fractions(min_value=1, max_value=2000, max_denominator=1000),
)
def test_every_timestamp_is_within_half_a_nanosecond_of_the_exact_time(base, frame, fps):
    (stamp,) = frame_timestamps(base, [frame], float(fps)).tolist()
    exact = base + frame * 10**9 / Fraction(repr(float(fps)))
    assert abs(stamp - exact) <= Fraction(1, 2)


def test_a_motion_that_ends_later_than_a_session_can_is_refused():
    with pytest.raises(ConfigError, match="2116"):
        frame_timestamps(2**63 - 10, range(3), 30.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0", 0),
        ("1700000000000000001", 1_700_000_000_000_000_001),
        ("1970-01-01T00:00Z", 0),
        ("1970-01-01 00:00:01z", 10**9),
        ("2026-03-01T12:00:00.123456789Z", 1_772_366_400_123_456_789),
        ("2026-03-01T12:00:00.5Z", 1_772_366_400_500_000_000),
        ("2026-03-01T13:30:00+0130", 1_772_366_400_000_000_000),
        ("2026-03-01T09:00:00-03:00", 1_772_366_400_000_000_000),
    ],
)
def test_times_people_write(text, expected):
    assert parse_time(text) == expected


@given(
    st.datetimes(datetime(1970, 1, 2), datetime(2115, 1, 1)),
    st.integers(-14 * 60, 14 * 60),
)
def test_iso_times_are_what_datetime_takes_them_for(moment, offset_minutes):
    zoned = moment.replace(tzinfo=timezone(timedelta(minutes=offset_minutes)))
    since = zoned - datetime(1970, 1, 1, tzinfo=timezone.utc)
    expected = since // timedelta(microseconds=1) * 1000
    assert parse_time(zoned.isoformat()) == expected


@pytest.mark.parametrize(
    "text",
    [
        "2026-03-01T12:00:00",
        "yesterday",
        "2026-13-01T12:00Z",
        "2026-03-01T12:00:00+24:00",
        pytest.param("9" * 5000, id="5000 digits"),
        "-1",
        "9223372036854775808",
    ],
)
def test_times_that_cannot_be_used_are_named(text):
    with pytest.raises(ConfigError) as caught:
        parse_time(text)
    assert text in caught.value.cause
