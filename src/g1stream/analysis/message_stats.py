"""How regularly the messages of a topic came, and on whose clock they are stamped; pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.session.streams import Stream

__all__ = [
    "GAP",
    "PERCENTILE_NAMES",
    "MessageStats",
    "Percentiles",
    "message_stats",
    "stats_by_topic",
]

GAP: Final = 3.0
"""A publish interval of more than so many medians is a gap."""

#: Topics whose messages come when something happens: they have no rate and no gaps.
_EVENTS: Final = ("/log", "/robot_description", "/scene")


PERCENTILE_NAMES: Final = ("p50", "p99", "p99.9", "max")
"""What the figures of a `Percentiles` are called, in its order, in JSON and in text."""


class Percentiles(NamedTuple):
    """Of a latency or lateness, us."""

    p50: float
    p99: float
    p99_9: float
    maximum: float

    def as_dict(self) -> dict[str, float]:
        """The figures under the names that the streamer gives them, too."""
        return dict(zip(PERCENTILE_NAMES, self, strict=True))


@dataclass(frozen=True)
class MessageStats:
    """How the messages of a topic came.

    Attributes:
        count: how many.
        rate: messages per second from the first to the last stamp, Hz; None for less than two.
        gaps: publish intervals of more than `GAP` medians.
        longest_interval: between two stamps, s; None for less than two.
        latency: log time - publish time. Where two clocks differ, they are in it.
        clock_offset: what must be added to a stamp to be on the recorder's clock, s; 0 where
            the clocks agree as far as can be seen.
    """

    count: int
    rate: float | None
    gaps: int
    longest_interval: float | None
    latency: Percentiles
    clock_offset: float

    def as_dict(self) -> dict[str, Any]:
        """The figures as JSON values, units in the keys."""
        return {
            "count": self.count,
            "rate_hz": self.rate,
            "gaps": self.gaps,
            "longest_interval_s": self.longest_interval,
            "latency_us": self.latency.as_dict(),
            "clock_offset_s": self.clock_offset,
        }


def message_stats(stream: Stream) -> MessageStats:
    """How the messages of a topic came.

    Args:
        stream: with one message at least.
    """
    stamps = np.sort(stream.publish_time)
    intervals = np.diff(stamps) / 1e9
    span = float(stamps[-1] - stamps[0]) / 1e9
    latency = (stream.log_time - stream.publish_time) / 1e3
    return MessageStats(
        count=len(stamps),
        rate=len(intervals) / span if span > 0 else None,
        gaps=int(np.sum(intervals > GAP * np.median(intervals))) if len(intervals) else 0,
        longest_interval=float(intervals.max()) if len(intervals) else None,
        latency=Percentiles(*np.percentile(latency, (50, 99, 99.9, 100)).tolist()),
        clock_offset=stream.clock_offset / 1e9,
    )


def stats_by_topic(times: Mapping[str, Stream]) -> dict[str, MessageStats]:
    """How the messages of each topic came, without those of events."""
    return {topic: message_stats(one) for topic, one in times.items() if topic not in _EVENTS}
