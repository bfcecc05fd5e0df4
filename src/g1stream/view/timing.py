"""How regularly a stream is published, and how late it is received."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.types import Floats, Ints

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Timing"]

#: ns of publish times that one result is about.
_SPAN: Final = 50_000_000


class Timing:
    """Finds the longest interval and latency in each 0.05 s of a stream that comes in batches."""

    def __init__(self) -> None:
        self._last: int | None = None

    def longest(self, published: Ints, logged: Ints) -> tuple[NDArray[np.intp], Floats]:
        """What is longest in each span.

        Args:
            published: (T,) ns, publish times of a batch, at least one.
            logged: (T,) ns, their log times.

        Returns:
            (K,) index of the first sample of each span, and (K, 2) ms: the longest time between
            two publish times, and from publish time to log time.
        """
        starts = np.flatnonzero(np.diff(published // _SPAN, prepend=-1))
        previous = published[0] if self._last is None else self._last
        self._last = int(published[-1])
        intervals = np.diff(published, prepend=previous)
        values = np.stack([intervals, logged - published], axis=-1) / 1e6
        return starts, np.maximum.reduceat(values, starts)
