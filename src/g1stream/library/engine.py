"""Where calls are made: in processes of this machine, or by the workers of a Dask scheduler.

On one machine a thread for each process hands out the calls (`concurrent.futures`); with Dask the
workers' threads do the same, so that both have the same limits, and the same results.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import time
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import islice
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, TypeVar

from g1stream._version import __version__
from g1stream.errors import ConfigError
from g1stream.library.processes import end_processes
from g1stream.optional import import_extra

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Executor

__all__ = ["completed", "open_executor"]

T = TypeVar("T")
R = TypeVar("R")

#: Calls that are handed over and not done; a scheduler of 1,000 cores has four for each.
_WINDOW: Final = 4096
#: What is done within this time is handed back together, s: to write a row alone takes 10 ms.
_TOGETHER: Final = 0.25
#: To reach the scheduler, s.
_TIMEOUT: Final = 10.0
#: Between two looks at whether to stop, s.
_POLL: Final = 0.2


@contextmanager
def open_executor(
    workers: int,
    cluster: str | None = None,
    *,
    warn: Callable[[str], None] = lambda text: None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[Executor]:
    """What calls are submitted to.

    Args:
        workers: processes on this machine.
        cluster: address of a Dask scheduler, such as `tcp://host:8786`, that is used instead.
        warn: called with what keeps it waiting, and what to do.
        stop: asked now and then; whether not to wait for workers.

    Raises:
        ConfigError: the extra `cluster` is not installed, there is no scheduler, or its workers
            lack g1stream, have another version, or cannot start processes.
    """
    if cluster:
        with _client(cluster, warn, stop) as client:
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
def _client(cluster: str, warn: Callable[[str], None], stop: Callable[[], bool]) -> Iterator[Any]:
    distributed = import_extra("distributed", "cluster", "--cluster needs")
    try:
        with ThreadPoolExecutor(1) as thread:  # a notebook has a loop of its own in this one
            thread.submit(asyncio.run, _connected(cluster)).result()
        client = distributed.Client(cluster, timeout=_TIMEOUT, set_as_default=False)
    except TypeError as error:  # which it raises for TLS without certificates
        raise ConfigError(
            f"The Dask scheduler {cluster} takes TLS connections only: {error}.",
            "Name its certificates in Dask's configuration, distributed.comm.tls.",
        ) from error
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"There is no Dask scheduler at {cluster}: {error}.",
            "Start one, `dask scheduler`, and give the address that it prints.",
        ) from error
    with client:
        if not client.nthreads():
            warn(
                f"The scheduler {cluster} has no workers: waiting for some. Start them with "
                f"`dask worker {cluster} --no-nanny`, one for each machine."
            )
        while not client.nthreads() and not stop():
            time.sleep(_POLL)
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


async def _connected(cluster: str) -> None:
    """Connect once: a Client that cannot waits 20 s when it is deleted, and prints a traceback."""
    from distributed.comm import connect
    from distributed.security import Security

    security = Security().get_connection_args("client")
    comm = await connect(cluster, timeout=_TIMEOUT, **security)
    await comm.close()


def _about_worker() -> tuple[str, bool]:
    """Version of g1stream, and whether this process may not start others."""
    return __version__, multiprocessing.current_process().daemon


def completed(
    executor: Executor,
    function: Callable[[T], R],
    items: Iterable[T],
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[list[tuple[T, Future[R]]]]:
    """Call a function with each item; yields those that are done, some together.

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
    due = 0.0
    while running and not stop():
        futures: list[Future[R]] = []
        with suppress(Empty):
            futures.append(done.get(timeout=_POLL))
            while len(futures) < len(running):
                futures.append(done.get(timeout=max(0.0, due - time.monotonic())))
        if futures:
            due = time.monotonic() + _TOGETHER
            pairs = [(running.pop(future), future) for future in futures]
            submit(len(pairs))
            yield pairs
        elif _has_lost_scheduler(executor):
            for future in running:
                future.cancel()  # which puts it into `done`
    for future in running:
        future.cancel()


def _has_lost_scheduler(executor: Executor) -> bool:
    """Whether its Dask client is closed: a result that was on its way then is never set."""
    client = getattr(executor, "_client", None)
    return client is not None and client.status == "closed"
