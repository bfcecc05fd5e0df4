"""When a session was in which phase; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from g1stream.control.phases import Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Span", "phase_spans"]


class Span(NamedTuple):
    """A phase from `start` to `end`, s."""

    phase: Phase
    start: float
    end: float

    @property
    def seconds(self) -> float:
        """How long it lasted."""
        return self.end - self.start


def phase_spans(times: NDArray[np.float64], phases: NDArray[np.uint8]) -> list[Span]:
    """The phases in the order that they came; each lasts until the next one begins.

    Args:
        times: (N,) when references were published, s.
        phases: (N,) the phase of each.
    """
    if not len(times):
        return []
    starts = np.concatenate([[0], np.flatnonzero(np.diff(phases)) + 1])
    ends = np.concatenate([starts[1:], [len(times) - 1]])
    return [
        Span(Phase(int(phases[start])), float(times[start]), float(times[end]))
        for start, end in zip(starts, ends, strict=True)
    ]
