"""The part of a session in ranges of time."""

from __future__ import annotations

from functools import cached_property
from itertools import compress
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from g1stream.errors import RecordingError
from g1stream.session.session import Session
from g1stream.session.stream import Stream
from g1stream.types import Floats, Phase

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from g1stream.session.session import Message
    from g1stream.session.streams import LogEvent

__all__ = ["select"]

StreamT = TypeVar("StreamT", bound=Stream)


def select(session: Session, phase: str | Phase | None, time: slice | None) -> Session:
    """See `Session.sel`."""
    ranges = [(-np.inf, np.inf)] if phase is None else _phase_ranges(session, phase)
    if time is not None:
        first = -np.inf if time.start is None else time.start
        end = np.inf if time.stop is None else np.nextafter(time.stop, np.inf)
        ranges = [(max(a, first), min(b, end)) for a, b in ranges]
    return _Selection(session, ranges)


def _phase_ranges(session: Session, phase: str | Phase) -> list[tuple[float, float]]:
    name = phase.name if isinstance(phase, Phase) else phase.upper()
    if name not in Phase.__members__:
        raise RecordingError(
            f"There is no phase {phase!r}.", f"Choose from {', '.join(Phase.__members__)}."
        )
    phases = session.phases
    ends = [*(one.start_s for one in phases[1:]), np.inf][: len(phases)]
    return [
        (one.start_s, end)
        for one, end in zip(phases, ends, strict=True)
        if one.phase is Phase[name]
    ]


class _Selection(Session):
    """A session restricted to ranges of time (first, end), s, the end excluded."""

    def __init__(self, whole: Session, ranges: list[tuple[float, float]]) -> None:
        super().__init__(whole._source)
        self._whole, self._ranges = whole, ranges
        self.start_ns = whole.start_ns

    def _inside(self, times: Floats) -> NDArray[np.bool_]:
        inside = np.zeros(len(times), dtype=bool)
        for first, end in self._ranges:
            inside |= (times >= first) & (times < end)
        return inside

    def _make_stream(self, kind: type[StreamT]) -> StreamT:
        stream = self._whole.stream(kind)
        return stream[self._inside(stream.time)]

    def read(self, columns: Mapping[type[Stream], Sequence[str]]) -> None:
        self._whole.read(columns)

    @cached_property
    def times(self) -> dict[str, Stream]:
        return {topic: one[self._inside(one.time)] for topic, one in self._whole.times.items()}

    @cached_property
    def log(self) -> list[LogEvent]:
        seconds = np.array([event.time - self.start_ns for event in self._whole.log]) / 1e9
        return list(compress(self._whole.log, self._inside(seconds)))

    def messages(self, topic: str) -> Iterator[Message]:
        self._columns.require(topic)
        times = self._whole._read_times([topic])[topic].time
        return compress(self._whole.messages(topic), self._inside(times))
