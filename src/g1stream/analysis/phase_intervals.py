"""When a session was in which phase; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from g1stream.errors import RecordingError
from g1stream.types import Phase

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

    Raises:
        RecordingError: a number is no phase's.
    """
    if not len(times):
        return []
    starts = np.concatenate([[0], np.flatnonzero(np.diff(phases)) + 1])
    ends = np.concatenate([starts[1:], [len(times) - 1]])
    return [
        Span(_phase(int(phases[start])), float(times[start]), float(times[end]))
        for start, end in zip(starts, ends, strict=True)
    ]


def _phase(number: int) -> Phase:
    try:
        return Phase(number)
    except ValueError as error:
        raise RecordingError(
            f"A reference is in phase {number}, which is none of those known here: "
            f"{', '.join(f'{phase.value} {phase.name}' for phase in Phase)}.",
            "Open it with the version of g1stream that recorded it; if that is this one, the file "
            "is damaged.",
        ) from error
