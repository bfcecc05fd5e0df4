"""Diagnostics of a recording: lost samples, and steps and offsets of clocks.

DDS does not report to a best-effort reader which samples were lost on the network. Therefore there
are four sources: the reader's own counts, the ticks with which g1stream's programs number Reference
and LowState, the publish time that a Reference shares with its LowCmd, and the number of datagrams
that the kernel discarded because a buffer was full. The LowState ticks of other publishers cannot
be used. Those of unitree_mujoco's C++ bridge repeat and jump even if no sample is lost.

Steps of this host's clock, and its offset from the clocks of other hosts, are detected but not
corrected; log and publish times are recorded unchanged.
"""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from g1stream.dds.messages import COMMAND_NAMES, LOWCMD, LOWSTATE, REFERENCE, Samples
from g1stream.dds.ticks import TickGaps
from g1stream.dds.udp_sockets import socket_inodes, udp_sockets
from g1stream.session.records import ClockStep

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from g1stream.dds.messages import Batch

__all__ = [
    "ClockReading",
    "Losses",
    "MissingCommands",
    "StepDetector",
    "dropped_datagrams",
    "read_clocks",
]

#: Maximum wait for the LowCmd of a Reference, ns.
_MAX_WAIT_NS: Final = 1_000_000_000
#: Maximum time by which a Reference may arrive before its LowCmd at the end of a recording, ns.
_LAST_WAIT_NS: Final = 20_000_000
#: Number of samples of a writer after which the step of its ticks is known.
_MIN_TICKS: Final = 10

_TOPICS_WITH_TICKS: Final = {topic.name: topic for topic in (REFERENCE, LOWSTATE)}

#: Change of CLOCK_REALTIME between two readings above which it was set and not slewed, ns.
_MIN_STEP: Final = 2_000_000


class MissingCommands:
    """Counts References whose LowCmd, with the same publish time, did not arrive.

    Attributes:
        topic: DDS topic of the commands that had a Reference.
        count: number of References without one.
    """

    def __init__(self) -> None:
        self.topic = LOWCMD.name
        self.count = 0
        # Apart by topic: the robot's own controller publishes on /lowcmd with its own clock.
        self._commands: dict[str, set[int]] = defaultdict(set)
        self._references: set[int] = set()
        self._newest = 0

    def add_commands(self, topic: str, publish_times: Iterable[int]) -> None:
        """Add the publish times of the LowCmds of a topic, ns.

        This also drops old unmatched ones, because there may be commands without references.
        """
        times = set(publish_times)
        before = min(times, default=0) - _MAX_WAIT_NS
        self._commands[topic] = {time for time in self._commands[topic] if time >= before} | times

    def add_references(self, publish_times: Sequence[int]) -> None:
        """Add the publish times of References, ns, oldest first."""
        self._references.update(publish_times)
        self._newest = publish_times[-1]

    def settle(self) -> None:
        """Count the References without a LowCmd, once all samples of a drain have been added.

        After the recorder was stopped, a drain has seconds of both.
        """
        self._settle(self._newest - _MAX_WAIT_NS)

    def finish(self) -> None:
        """Count the References that are still unmatched after the last sample."""
        self._settle(self._newest - _LAST_WAIT_NS)

    def _settle(self, before: int) -> None:
        """Drop pairs, and count References before this time without a LowCmd."""
        for topic, times in self._commands.items():
            if pairs := self._references & times:
                self.topic = topic
                self._references -= pairs
            self._commands[topic] = {time for time in times - pairs if time >= before}
        alone = {time for time in self._references if time < before}
        self._references -= alone
        self.count += len(alone)


def dropped_datagrams(pid: int) -> int:
    """Number of datagrams that the kernel discarded because a process's socket buffer was full."""
    process = Path("/proc", str(pid))
    inodes = set(socket_inodes(process))
    return sum(one.dropped for one in udp_sockets(process) if one.inode in inodes)


class Losses:
    """Counts samples that are known to be lost, by DDS topic.

    Attributes:
        lost: number of lost samples, by topic name.
    """

    def __init__(self) -> None:
        self.lost: dict[str, int] = {}
        self._ticks: dict[str, dict[int, TickGaps]] = defaultdict(lambda: defaultdict(TickGaps))
        self._commands = MissingCommands()

    def add(self, name: str, batch: Batch) -> None:
        """Add samples of a topic, oldest first; the ticks of each writer are independent."""
        if name in COMMAND_NAMES:
            self._commands.add_commands(name, batch.publish_times)
        if name == REFERENCE.name:
            self._commands.add_references(batch.publish_times)
        if topic := _TOPICS_WITH_TICKS.get(name):
            ticks = Samples(topic, batch.data)["tick"].tolist()
            for writer, tick in zip(batch.writers, ticks, strict=True):
                self._ticks[name][writer].add(tick)

    def finish(self) -> None:
        """Count the LowCmds that are still missing after the last batch."""
        self._commands.finish()

    def update(
        self, lost_by_reader: Mapping[str, int], *, state_step: float | None
    ) -> dict[str, int]:
        """Combine all sources of lost samples.

        Args:
            lost_by_reader: total number of samples that the readers report as lost, by topic name.
            state_step: step of the LowState ticks, ms; None if they do not number the samples.

        Returns:
            The number of newly lost samples, by topic name; only topics with new losses.
        """
        self._commands.settle()
        more = {}
        for name, by_reader in lost_by_reader.items():
            step = state_step if name == LOWSTATE.name else 1.0
            counters = self._ticks[name].values() if step else ()
            by_ticks = sum(c.missed(step) for c in counters if step and c.received > _MIN_TICKS)
            by_reference = self._commands.count if name == self._commands.topic else 0
            lost, before = max(by_reader, by_ticks, by_reference), self.lost.get(name, 0)
            if lost > before:
                more[name] = lost - before
            self.lost[name] = lost
        return more


class ClockReading(NamedTuple):
    """CLOCK_REALTIME and CLOCK_MONOTONIC at one instant, ns."""

    realtime: int
    monotonic: int


def read_clocks() -> ClockReading:
    """Read both clocks at nearly the same instant; uses the closest of several readings."""
    readings = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(5)]
    before, realtime, after = min(readings, key=lambda one: one[2] - one[0])
    return ClockReading(realtime, (before + after) // 2)


@dataclass
class StepDetector:
    """Detects steps of CLOCK_REALTIME by its offset from CLOCK_MONOTONIC.

    Slewing, as by NTP at up to 0.5 ms per second, is not a step. It appears as the difference of
    `first` and `last`.

    Attributes:
        first, last: realtime minus monotonic at the first and the last reading, ns.
        steps: the detected steps, in order.
    """

    first: int | None = None
    last: int = 0
    steps: list[ClockStep] = field(default_factory=list)

    def observe(self, reading: ClockReading) -> int:
        """Return the step of the clock since the previous reading, ns; 0 without a step.

        Args:
            reading: a reading at most a few tenths of a second after the previous one.
        """
        offset = reading.realtime - reading.monotonic
        if self.first is None:
            self.first = self.last = offset
        step, self.last = offset - self.last, offset
        if abs(step) < _MIN_STEP:
            return 0
        self.steps.append(ClockStep(at_ns=reading.realtime, step_ns=step))
        return step
