"""Times in whole nanoseconds: of the frames of a motion, and as people write them.

Nothing here goes through float seconds or the local time zone.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from fractions import Fraction
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from g1stream.types import Ints

__all__ = ["frame_timestamps", "parse_time"]

_NS_PER_S: Final = 1_000_000_000
#: The last time that a signed 64-bit number holds, in the year 2262.
_LAST_NS: Final = 2**63 - 1
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=timezone.utc)
#: At most 40 digits: Python refuses to convert thousands of them.
_WHOLE: Final = re.compile(r"[+-]?[0-9]{1,40}")
_ISO: Final = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9}))?(Z|[+-]\d\d:?[0-5]\d)?",
    re.IGNORECASE,
)


def frame_timestamps(base_ns: int, frames: Iterable[int], fps: float) -> Ints:
    """Times of frames: base + frame / fps, to the nearest nanosecond, halves up; (T,) int64.

    The frame rate is taken as the decimal number that it prints as, so that 29.97 is 2997/100; the
    division is one of whole numbers, so that no rounding adds up however long the motion is.

    Args:
        base_ns: time of frame 0, ns since the epoch, not negative.
        frames: frame numbers, not negative, rising.
        fps: frames per second, above 0.

    Raises:
        ConfigError: a time lies after the year 2262, where 64 bits end.
    """
    rate = Fraction(repr(float(fps)))
    numerator, denominator = 2 * _NS_PER_S * rate.denominator, 2 * rate.numerator
    times = [base_ns + (frame * numerator + rate.numerator) // denominator for frame in frames]
    if times and times[-1] > _LAST_NS:
        raise ConfigError(
            "The motion would end after the year 2262, where nanoseconds in 64 bits end.",
            "Give an earlier base time.",
        )
    return np.array(times, dtype=np.int64)


def parse_time(text: str) -> int:
    """A time as ns since the epoch.

    Args:
        text: whole nanoseconds since 1970-01-01T00:00Z, or ISO 8601 with a time zone, such as
            `2026-03-01T12:00:00.123456789Z` or `2026-03-01 12:00+01:00`.

    Raises:
        ConfigError: it is neither, or before 1970 or after 2262.
    """
    time = int(text) if _WHOLE.fullmatch(text) else _parse_iso(text)
    if not 0 <= time <= _LAST_NS:
        raise ConfigError(
            f"The time {text} is {'before 1970' if time < 0 else 'after 2262'}.",
            "Give one between 0 and 2^63 - 1 ns since the epoch.",
        )
    return time


def _parse_iso(text: str) -> int:
    match = _ISO.fullmatch(text)
    if match is None:
        raise _not_a_time(text)
    date, clock, fraction, zone = match.groups()
    if zone is None:
        raise ConfigError(
            f"The time {text} has no time zone.",
            f"Add one: {text}Z for UTC, or an offset such as {text}+01:00.",
        )
    # Python 3.10 reads neither Z nor an offset without a colon, and no version nanoseconds.
    offset = "+00:00" if zone in "Zz" else f"{zone[:3]}:{zone[-2:]}"
    try:
        moment = datetime.fromisoformat(f"{date}T{clock}{offset}")
    except ValueError as error:
        raise _not_a_time(text) from error
    seconds = (moment - _EPOCH) // timedelta(seconds=1)
    return seconds * _NS_PER_S + int((fraction or "").ljust(9, "0"))


def _not_a_time(text: str) -> ConfigError:
    return ConfigError(
        f"{text!r} is not a time.",
        "Give nanoseconds since the epoch, or ISO 8601 such as 2026-03-01T12:00:00Z.",
    )
