"""Counts the samples that were published and did not come.

The witnesses: what the reader itself knows, the numbers that some messages carry, the stamp that a
Reference shares with its LowCmd, and the kernel, which counts the datagrams that it had to drop
because nobody fetched them. A best-effort reader is not told by DDS what it missed on the way.
"""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.dds.topics import LOWCMD, LOWSTATE, REFERENCE
from g1stream.session.samples import Samples

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from g1stream.session.samples import Batch

__all__ = ["Counter", "Losses", "Partners", "dropped_datagrams"]

#: A number that leaps further was not lost on the way: its publisher was started anew.
_JUMP: Final = 10_000
#: Steps to have seen before it is known by how much a number grows.
_ENOUGH: Final = 8
#: How long a Reference's LowCmd may be on its way, ns.
_PATIENCE: Final = 1_000_000_000
#: At the end of a recording, how far a Reference may be ahead of its LowCmd, ns.
_ON_ITS_WAY: Final = 20_000_000

#: The field that numbers the samples. LowState's is 0 for ever on one of the simulators; then
#: nothing can be known from it.
_NUMBERED: Final = {topic.name: (topic, "tick") for topic in (REFERENCE, LOWSTATE)}


@dataclass
class Counter:
    """Finds holes in the number that each sample of one writer carries.

    Attributes:
        step: by how much the number grows from one sample to the next; 0 until it is known.
    """

    step: int = 0
    _last: int | None = None
    _early: list[NDArray[np.int64]] = field(default_factory=list)

    def count(self, numbers: NDArray[np.int64]) -> int:
        """How many samples are missing between the (T,) numbers, and before them."""
        steps = np.diff(numbers if self._last is None else np.append(self._last, numbers))
        self._last = int(numbers[-1])
        if not self.step:
            self._early.append(steps)
            steps = np.concatenate(self._early)
            forward = steps[steps > 0]
            if forward.size < _ENOUGH:
                return 0
            self.step = int(np.median(forward))
            self._early.clear()
        missed = steps // self.step - 1
        return int(missed[(missed > 0) & (missed < _JUMP)].sum())


class Partners:
    """Finds References whose LowCmd, of the very same stamp, did not come."""

    def __init__(self) -> None:
        self._commands: set[int] = set()
        self._references: set[int] = set()
        self._newest = 0

    def add_commands(self, stamps: Iterable[int]) -> None:
        """Take in the publish times of LowCmds, ns."""
        self._commands.update(stamps)

    def add_references(self, stamps: Sequence[int]) -> int:
        """Take in the publish times of References, ns; how many more LowCmds are missing."""
        self._references.update(stamps)
        self._newest = stamps[-1]
        pairs = self._references & self._commands
        self._references -= pairs
        self._commands -= pairs
        old = stamps[-1] - _PATIENCE
        alone = {stamp for stamp in self._references if stamp < old}
        self._references -= alone
        self._commands = {stamp for stamp in self._commands if stamp >= old}
        return len(alone)

    def finish(self) -> int:
        """At the end, how many more LowCmds are missing; the last few may just not be here yet."""
        due = self._newest - _ON_ITS_WAY
        return sum(stamp < due for stamp in self._references)


def dropped_datagrams() -> int:
    """How many datagrams the kernel dropped for want of room in this process's sockets."""
    inodes = set()
    for descriptor in Path("/proc/self/fd").glob("*"):
        with suppress(OSError):  # closed in the meantime
            inodes.add(descriptor.readlink().name.removeprefix("socket:[").removesuffix("]"))
    dropped = 0
    for table in (Path("/proc/net/udp"), Path("/proc/net/udp6")):
        if table.exists():
            rows = (line.split() for line in table.read_text().splitlines()[1:])
            dropped += sum(int(row[-1]) for row in rows if row[9] in inodes)
    return dropped


class Losses:
    """What is known to be missing, by DDS topic.

    Attributes:
        missing: samples, by topic name.
    """

    def __init__(self) -> None:
        self.missing: dict[str, int] = {}
        self._counters: dict[tuple[str, int], Counter] = defaultdict(Counter)
        self._by_number: dict[str, int] = defaultdict(int)
        self._partners = Partners()

    def look(self, name: str, batch: Batch) -> None:
        """Look through a batch, oldest sample first, the numbers of each writer by themselves."""
        if name == LOWCMD.name:
            self._partners.add_commands(batch.publish_times)
        if name == REFERENCE.name:
            missed = self._partners.add_references(batch.publish_times)
            self._by_number[LOWCMD.name] += missed
        if name not in _NUMBERED:
            return
        topic, path = _NUMBERED[name]
        numbers = Samples(topic, batch.data)[path].astype(np.int64)
        writers = np.array(batch.writers)
        for writer in np.unique(writers):
            missed = self._counters[name, int(writer)].count(numbers[writers == writer])
            self._by_number[name] += missed

    def finish(self) -> None:
        """Count, after the last batch, what has waited for its partner in vain."""
        self._by_number[LOWCMD.name] += self._partners.finish()

    def update(self, lost: Mapping[str, int]) -> dict[str, int]:
        """Join what the witnesses say.

        Args:
            lost: samples that the readers know to be lost so far, by topic name.

        Returns:
            How many more are missing than at the last update, where any are.
        """
        news = {}
        for name, by_reader in lost.items():
            missing = max(by_reader, self._by_number[name])
            if missing > self.missing.get(name, 0):
                news[name] = missing - self.missing.get(name, 0)
            self.missing[name] = missing
        return news
