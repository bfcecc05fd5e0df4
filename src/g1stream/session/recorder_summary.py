"""What a recording holds, and what it lacks; the recorder writes this into the file's metadata."""

from __future__ import annotations

from g1stream.session.records import Int, Record

__all__ = ["ClockStep", "MeasuredTf", "RecorderSummary", "TopicDelay"]


class ClockStep(Record):
    """CLOCK_REALTIME was set by `step_ns` when, after that, it was `at_ns`."""

    at_ns: Int | None = None
    step_ns: Int


class TopicDelay(Record):
    """How long the messages of a topic took.

    Attributes:
        hosts: of the publishers.
        median_ns: of log minus publish time.
        clock_offset_estimate_ns: where a publisher is on another host, that median as the offset
            between the clocks, transit included.
    """

    hosts: list[str] = []
    median_ns: Int | None = None
    clock_offset_estimate_ns: Int | None = None


class MeasuredTf(Record):
    """How the measured robot was placed in the world of the reference.

    Attributes:
        yaw_offset_rad: what was added to the measured yaw; None where no attitude was known.
        position_from: sportmodestate, reference or none.
    """

    yaw_offset_rad: float | None = None
    position_from: str | None = None


class RecorderSummary(Record):
    """What a recording holds, and what it lacks; topics are those of the file.

    Attributes:
        path: the file, or the directory of its parts.
        paths: the files.
        removed: whether they were removed, because nothing was received.
        first_ns, last_ns: log times of the first and the last sample, since the epoch.
        counts: messages by topic.
        absent: topics of DDS that nobody published.
        lost: by topic, samples known to be lost.
        malformed: by topic, samples that were not of its type and are not in the file.
        publishers: by topic of the state and of commands, the programs that published at the same
            time; empty where there was one.
        dropped_datagrams: received by the kernel, and discarded because its buffer was full; of
            which topic is not known.
        stopped: why the recording ended before it was told to; empty when it did not.
        realtime_minus_monotonic_ns: the two clocks of this host, at the first and last reading.
        clock_steps: when CLOCK_REALTIME was set, and by how much.
        delays: by topic.
        measured_tf: how the measured robot was placed.
    """

    path: str = ""
    paths: list[str] = []
    removed: bool = False
    first_ns: Int | None = None
    last_ns: Int | None = None
    counts: dict[str, Int] = {}
    absent: list[str] = []
    lost: dict[str, Int] = {}
    malformed: dict[str, Int] = {}
    publishers: dict[str, list[str]] = {}
    dropped_datagrams: Int = 0
    stopped: str = ""
    realtime_minus_monotonic_ns: tuple[Int, Int] | None = None
    clock_steps: list[ClockStep] = []
    delays: dict[str, TopicDelay] = {}
    measured_tf: MeasuredTf | None = None

    @property
    def complete(self) -> bool:
        """Whether, as far as is known, everything published until the end is in the file."""
        lacking = (self.dropped_datagrams, *self.lost.values(), *self.malformed.values())
        return not self.stopped and not any(lacking)

    @property
    def duration_s(self) -> float | None:
        """From the first sample to the last, s; None without a sample."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return (self.last_ns - self.first_ns) / 1e9
