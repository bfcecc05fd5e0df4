"""How regularly the messages of a topic were published, and how long they took; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.session.summary import MessageStats, Percentiles

if TYPE_CHECKING:
    from g1stream.session.streams import Stream

__all__ = ["GAP", "message_stats"]

GAP: Final = 3.0
"""A publish interval of more than so many medians is a gap."""


def message_stats(stream: Stream, lost: int | None = None) -> MessageStats:
    """The rate, gaps and latency of a topic.

    Args:
        stream: with one message at least.
        lost: samples known to be lost.
    """
    times_ns = np.sort(stream.publish_time)
    intervals = np.diff(times_ns) / 1e9
    span = float(times_ns[-1] - times_ns[0]) / 1e9
    latency = (stream.log_time - stream.publish_time) / 1e3
    p50, p99, p99_9, longest = np.percentile(latency, (50, 99, 99.9, 100)).tolist()
    return MessageStats(
        count=len(times_ns),
        lost=lost,
        rate_hz=len(intervals) / span if span > 0 else None,
        gaps=int(np.sum(intervals > GAP * np.median(intervals))) if len(intervals) else 0,
        longest_interval_s=float(intervals.max()) if len(intervals) else None,
        latency_us=Percentiles(p50=p50, p99=p99, p99_9=p99_9, max=longest),
        clock_offset_s=stream.clock_offset / 1e9,
    )
