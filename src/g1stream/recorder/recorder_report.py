"""What a recorder says of its recording."""

from __future__ import annotations

import socket
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from g1stream.dds.domain import Participant

__all__ = ["Publishers", "RecorderReport"]


@dataclass(frozen=True)
class Publishers:
    """Who writes a topic.

    Attributes:
        names: each as well as it can be named.
        hosts: the hosts they are on, those that tell.
    """

    names: tuple[str, ...]
    hosts: tuple[str, ...]

    @classmethod
    def of(cls, participant: Participant, topic: str) -> Publishers:
        """Who writes a DDS topic now."""
        writers = participant.writers(topic)
        names = tuple(sorted({str(writer) for writer in writers}))
        return cls(names, tuple(sorted({writer.host for writer in writers if writer.host})))

    @property
    def elsewhere(self) -> bool:
        """Whether somebody among them is on another host, with a clock of its own."""
        return any(host != socket.gethostname() for host in self.hosts)

    def __str__(self) -> str:
        return " and ".join(self.names) or "a publisher that is gone"


@dataclass
class RecorderReport:
    """What a recording holds.

    Attributes:
        counts: messages by topic of the file.
        absent: topics of the wire that nobody published.
        missing: samples known to be lost, by topic of the file.
        malformed: samples that came and were not of their topic's type, by topic of the file; they
            are not in it.
        dropped: datagrams, each a sample or a part of one, that came and that the kernel had no
            room to keep until they were fetched; of which topic is not known.
        first, last: log times of the first and last sample, ns since the epoch.
        paths: the files.
        stopped: why the recording ended before it was told to; empty when it did not.
        clock: what this host's clock did.
        delays: by topic of the file: hosts of the publishers, median of log minus publish time; and
            where a publisher is on another host, that median as the offset between the clocks.
        measured_tf: how the measured robot was placed.
    """

    counts: dict[str, int] = field(default_factory=dict)
    absent: list[str] = field(default_factory=list)
    missing: dict[str, int] = field(default_factory=dict)
    malformed: dict[str, int] = field(default_factory=dict)
    dropped: int = 0
    first: int = 0
    last: int = 0
    paths: list[str] = field(default_factory=list)
    stopped: str = ""
    clock: dict[str, Any] = field(default_factory=dict)
    delays: dict[str, dict[str, Any]] = field(default_factory=dict)
    measured_tf: dict[str, Any] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether, as far as is known, everything published until the end is in the file."""
        lacking = (self.dropped, *self.missing.values(), *self.malformed.values())
        return not self.stopped and not any(lacking)

    def see(self, log_times: Sequence[int]) -> None:
        """Take note of when samples were received."""
        self.first = self.first or log_times[0]
        self.last = max(self.last, log_times[-1])

    def add_delay(self, topic: str, publishers: Publishers, median: int | None) -> None:
        """Note how long messages of a topic took, ns."""
        self.delays[topic] = {"hosts": list(publishers.hosts), "median_ns": median}
        if publishers.elsewhere:
            self.delays[topic]["clock_offset_estimate_ns"] = median

    def as_dict(self) -> dict[str, Any]:
        """The report as JSON values."""
        return {
            "counts": dict(sorted(self.counts.items())),
            "absent": self.absent,
            "missing": self.missing,
            "malformed": self.malformed,
            "dropped_datagrams": self.dropped,
            "duration_s": (self.last - self.first) / 1e9,
            "stopped": self.stopped,
            "paths": self.paths,
            "clock": self.clock,
            "delays": self.delays,
            "measured_tf": self.measured_tf,
        }
