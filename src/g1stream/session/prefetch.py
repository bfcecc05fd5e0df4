"""Work done a few steps ahead of where its results are needed."""

from __future__ import annotations

import os
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Final, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Future

__all__ = ["ahead"]

T = TypeVar("T")
R = TypeVar("R")

_MOST_THREADS: Final = 4


def ahead(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yield work(item) of each item in order, done by threads a few items ahead.

    Unlike `Executor.map`, it takes items only as results are taken, so that memory stays bounded.
    """
    n_threads = min(_MOST_THREADS, os.cpu_count() or 1)
    pending: deque[Future[R]] = deque()
    with ThreadPoolExecutor(n_threads) as pool:
        try:
            for item in items:
                pending.append(pool.submit(work, item))
                if len(pending) > 2 * n_threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
