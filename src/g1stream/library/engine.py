"""Where calls are made: in processes of this machine, or by the workers of a Dask scheduler.

On one machine a thread for each process hands out the calls (`concurrent.futures`); with Dask the
workers' threads do the same, so that both have the same limits, and the same results.
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, TypeVar

from g1stream._version import __version__
from g1stream.errors import ConfigError
from g1stream.extras import import_extra
from g1stream.library.processes import end_processes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Executor

__all__ = ["completed", "open_executor"]

T = TypeVar("T")
R = TypeVar("R")

#: Calls that are handed over and not done; a scheduler of 1,000 cores has four for each.
_WINDOW: Final = 4096
#: Between two looks at whether to stop, s.
_POLL: Final = 0.2


@contextmanager
def open_executor(workers: int, cluster: str | None = None) -> Iterator[Executor]:
    """What calls are submitted to.

    Args:
        workers: processes on this machine.
        cluster: address of a Dask scheduler, such as `tcp://host:8786`, that is used instead.

    Raises:
        ConfigError: the extra `cluster` is not installed, there is no scheduler, or its workers
            lack g1stream, have another version, or cannot start processes.
    """
    if cluster:
        with _client(cluster) as client:
            yield client.get_executor(pure=False)
        return
    threads = ThreadPoolExecutor(workers, "library")
    try:
        yield threads
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        joining = Thread(target=threads.shutdown)
        joining.start()
        while joining.is_alive():  # again and again: one may just be starting
            end_processes()
            joining.join(_POLL)


@contextmanager
def _client(cluster: str) -> Iterator[Any]:
    distributed = import_extra("distributed", "cluster", "--cluster needs")
    try:
        client = distributed.Client(cluster, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"There is no Dask scheduler at {cluster}: {error}.",
            "Start one, `dask scheduler`, and give the address that it prints.",
        ) from error
    with client:
        try:
            workers = set(client.run(_about_worker).values())
        except Exception as error:  # it raises what the worker raised
            raise ConfigError(
                f"The workers of {cluster} cannot run g1stream: {error}.",
                "Install g1stream on each of them.",
            ) from error
        if versions := {version for version, _ in workers} - {__version__}:
            raise ConfigError(
                f"Workers of {cluster} have g1stream {', '.join(sorted(versions))}.",
                f"Install g1stream {__version__} on each of them.",
            )
        if any(daemon for _, daemon in workers):
            raise ConfigError(
                f"The workers of {cluster} cannot start processes, as nannies watch over them.",
                "Start them with `dask worker --no-nanny`, one for each machine.",
            )
        yield client


def _about_worker() -> tuple[str, bool]:
    """Version of g1stream, and whether this process may not start others."""
    return __version__, multiprocessing.current_process().daemon


def completed(
    executor: Executor,
    function: Callable[[T], R],
    items: Iterable[T],
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[list[tuple[T, Future[R]]]]:
    """Call a function with each item; yields those that are done since the last yield.

    Args:
        executor: makes the calls.
        function: called with an item.
        items: taken as calls are done, so that there may be many.
        stop: asked now and then; what is not done then is not waited for.
    """
    done: SimpleQueue[Future[R]] = SimpleQueue()
    left = iter(items)
    running: dict[Future[R], T] = {}

    def submit(n: int) -> None:
        for item in islice(left, n):
            future = executor.submit(function, item)
            running[future] = item
            future.add_done_callback(done.put)

    submit(_WINDOW)
    while running and not stop():
        try:
            futures = [done.get(timeout=_POLL)]
        except Empty:
            continue
        while not done.empty():
            futures.append(done.get())
        pairs = [(running.pop(future), future) for future in futures]
        submit(len(pairs))
        yield pairs
    for future in running:
        future.cancel()
