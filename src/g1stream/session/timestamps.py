"""Exact times: frames of a motion to nanoseconds, and a time as people write it.

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

    from numpy.typing import NDArray

__all__ = ["frame_stamps", "parse_time"]

_NS_PER_S: Final = 1_000_000_000
#: The last stamp that a signed 64-bit number holds, in the year 2262.
_LAST_NS: Final = 2**63 - 1
#: Not longer than anybody means: Python refuses to read thousands of digits.
_WHOLE: Final = re.compile(r"[+-]?[0-9]{1,40}")
_ISO: Final = re.compile(
    r"(?P<date>\d{4}-\d\d-\d\d)[T ](?P<clock>\d\d:\d\d(:\d\d)?)"
    r"([.,](?P<fraction>\d{1,9}))?(?P<zone>Z|[+-]([01]\d|2[0-3]):?[0-5]\d)?",
    re.IGNORECASE,
)


def frame_stamps(base_ns: int, frames: Iterable[int], fps: float) -> NDArray[np.int64]:
    """Times of frames: base + frame / fps, to the nearest nanosecond, halves up; (T,) int64.

    The frame rate is taken as the decimal number that it prints as, so that 29.97 is 2997/100; the
    division is one of whole numbers, so that no rounding adds up however long the motion is.

    Args:
        base_ns: time of frame 0, ns since the epoch, not negative.
        frames: frame numbers, not negative.
        fps: frames a second, above 0.

    Raises:
        ConfigError: a stamp lies behind the year 2262, where 64 bits end.
    """
    rate = Fraction(repr(float(fps)))
    numerator, denominator = 2 * _NS_PER_S * rate.denominator, 2 * rate.numerator
    stamps = [base_ns + (frame * numerator + rate.numerator) // denominator for frame in frames]
    if stamps and stamps[-1] > _LAST_NS:
        raise ConfigError(
            "The motion would end after the year 2262, where nanoseconds in 64 bits end.",
            "Give an earlier base time.",
        )
    return np.array(stamps, dtype=np.int64)


def parse_time(text: str) -> int:
    """A time as ns since the epoch.

    Args:
        text: whole nanoseconds since 1970-01-01T00:00Z, or ISO 8601 with a zone, such as
            `2026-03-01T12:00:00.123456789Z` or `2026-03-01 12:00+01:00`.

    Raises:
        ConfigError: it is neither, or lies before 1970 or after 2262.
    """
    stamp = int(text) if _WHOLE.fullmatch(text) else _parse_iso(text)
    if not 0 <= stamp <= _LAST_NS:
        raise ConfigError(
            f"The time {text} is {'before 1970' if stamp < 0 else 'after 2262'}.",
            "Give one between 0 and 2^63 - 1 ns since the epoch.",
        )
    return stamp


def _parse_iso(text: str) -> int:
    match = _ISO.fullmatch(text)
    try:
        moment = datetime.fromisoformat(f"{match['date']}T{match['clock']}") if match else None
    except ValueError:
        moment = None
    if match is None or moment is None:
        raise ConfigError(
            f"{text!r} is not a time.",
            "Give nanoseconds since the epoch, or ISO 8601 such as 2026-03-01T12:00:00Z.",
        )
    if match["zone"] is None:
        raise ConfigError(
            f"The time {text} has no zone, so it means another moment on every machine.",
            f"Add one: {text}Z for UTC, or an offset such as {text}+01:00.",
        )
    since_epoch = moment.replace(tzinfo=timezone.utc) - datetime(1970, 1, 1, tzinfo=timezone.utc)
    seconds = since_epoch // timedelta(seconds=1) - _zone_seconds(match["zone"])
    return seconds * _NS_PER_S + int((match["fraction"] or "").ljust(9, "0"))


def _zone_seconds(zone: str) -> int:
    if zone in "Zz":
        return 0
    digits = zone[1:].replace(":", "")
    seconds = int(digits[:2]) * 3600 + int(digits[2:]) * 60
    return -seconds if zone[0] == "-" else seconds
