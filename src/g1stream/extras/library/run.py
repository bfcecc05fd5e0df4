"""Computes a library: finds motions, skips known rows, computes and writes the others."""

from __future__ import annotations

import asyncio
import os
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from ipaddress import ip_address
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, TypeVar

from g1stream._version import __version__
from g1stream.errors import ConfigError
from g1stream.extras.library.compute import Content, Task, contents_of, rows_of
from g1stream.extras.library.files import find_motions
from g1stream.extras.library.page import write_page
from g1stream.extras.library.processes import (
    CrashedError,
    Limits,
    TooSlowError,
    end_processes,
    limited,
)
from g1stream.extras.library.table import writing
from g1stream.optional import import_extra
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from concurrent.futures import Executor

    from g1stream.extras.library.compute import LibraryCase
    from g1stream.extras.library.table import MotionRow, Rows, TableWriter

__all__ = ["LibraryRun", "completed", "open_executor", "run_library"]

#: Number of files that are hashed in one call.
_BATCH: Final = 32


@dataclass
class LibraryRun:
    """State of a run over a library, during and after it.

    Attributes:
        files: number of motion files.
        copies: number of files that are the same as another.
        keys: keys of the requested rows.
        known: number of requested rows that existed before.
        done: number of computed rows.
        failed: number of computed rows whose motion could not be read or played.
        hashed: number of hashed files.
        lost: reason by location for what was not computed: its worker or the scheduler ended.
        computing: whether it is known what must be computed.
        elapsed: time of computing, s.
    """

    files: int = 0
    hashed: int = 0
    copies: int = 0
    keys: set[str] = field(default_factory=set)
    known: int = 0
    done: int = 0
    failed: int = 0
    lost: dict[str, str] = field(default_factory=dict)
    computing: bool = False
    elapsed: float = 0.0

    @property
    def total(self) -> int:
        """Number of requested rows."""
        return len(self.keys)

    @property
    def complete(self) -> bool:
        """Whether all requested rows exist."""
        return self.computing and not self.lost and self.known + self.done == self.total

    def status(self) -> tuple[float | None, str]:
        """Fraction done, 0 to 1, and a line of text."""
        if not self.computing:
            return None, f"reading {self.hashed} of {counted(self.files, 'file')}"
        to_do = self.total - self.known
        text = f"{self.done} of {counted(to_do, 'row')}"
        if self.done:
            rate = self.done / self.elapsed
            text += f", {rate:.3g} a second, {_span((to_do - self.done) / rate)} left"
        if self.failed:
            text += f", {self.failed} failed"
        return self.done / max(1, to_do), text


def _span(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes}:{rest:02} min"


def run_library(
    places: Sequence[str],
    cases: Sequence[LibraryCase],
    *,
    workers: int | None = None,
    cluster: str | None = None,
    insecure: bool = False,
    limits: Limits | None = None,
    run: LibraryRun | None = None,
    on_row: Callable[[MotionRow], None] = lambda row: None,
    stop: Callable[[], bool] = lambda: False,
    warn: Callable[[str], None] = lambda text: None,
) -> LibraryRun:
    """Compute the rows of all motions below some places, write them continuously, then a page.

    Existing rows with the same content, settings and versions are not computed again. Written rows
    are kept however the run ends, and the same call continues it.

    Args:
        places: directories, files and URLs.
        cases: computations for each motion, all with the same directory.
        workers: number of processes on this machine; one for each CPU if None.
        cluster: address of a Dask scheduler whose workers are used instead. Whoever runs it, or
            can change its messages, runs code here and on the workers.
        insecure: use a scheduler on another machine without TLS.
        limits: limits of time and memory for a row; the defaults if None.
        run: state of the run, updated during it; a new one if None.
        on_row: called with each written row.
        stop: polled; True ends the run early.
        warn: called with the reason for waiting, such as a scheduler without workers.

    Returns:
        The state of the finished run.

    Raises:
        ConfigError: a place does not exist, or an extra is not installed.
        RecordingError: the library's directory cannot be written, or another process writes to it.
    """
    run, limits = run or LibraryRun(), limits or Limits()
    _require_apart(places, cases[0].out)
    out = cases[0].out.absolute()  # workers on a cluster have other working directories
    cases = [replace(case, out=out) for case in cases]
    locations = find_motions(places)
    if not locations:
        raise ConfigError(
            f"There are no motion files below {', '.join(places)}.",
            "docs/formats.md lists the supported motion files.",
        )
    run.files = len(locations)
    with (
        writing(out) as table,
        open_executor(
            workers or os.cpu_count() or 1, cluster, insecure=insecure, warn=warn, stop=stop
        ) as executor,
    ):
        contents = list(_contents(executor, locations, run, stop))
        tasks: list[Task] = []
        if not stop():
            tasks += _tasks(contents, cases, table, str(limits), run)
            run.computing = True
        started = time.monotonic()
        compute = partial(_compute, limits=limits)
        for pairs in completed(executor, compute, tasks, stop):
            written = list(_results(pairs, run))
            if written:
                table.add(written)
            run.elapsed = time.monotonic() - started
            for rows in written:
                run.done += 1
                run.failed += rows.motion.status != "ok"
                on_row(rows.motion)
    if run.known or run.done:
        write_page(out)
    return run


def _require_apart(places: Sequence[str], out: Path) -> None:
    """Refuse a library's directory that contains motions, because it is not searched for them."""
    for place in places:
        path = Path(place).resolve()
        if "://" not in place and path.exists() and out.resolve() in (path, *path.parents):
            raise ConfigError(
                f"The library {out} would contain the motions in {place}, and hide them.",
                "Choose another directory for the library.",
            )


def _contents(
    executor: Executor, locations: list[str], run: LibraryRun, stop: Callable[[], bool]
) -> Iterator[tuple[str, Content]]:
    """The content at each location that can be read."""
    batches = [locations[i : i + _BATCH] for i in range(0, len(locations), _BATCH)]
    for pairs in completed(executor, contents_of, batches, stop):
        for batch, future in pairs:
            run.hashed += len(batch)
            if fault := _fault(future):
                run.lost |= dict.fromkeys(batch, fault)
            else:
                yield from future.result()


def _tasks(
    contents: list[tuple[str, Content]],
    cases: Sequence[LibraryCase],
    table: TableWriter,
    limits: str,
    run: LibraryRun,
) -> Iterator[Task]:
    """The remaining tasks, each content once."""
    seen = set()
    for location, content in sorted(contents):
        if content.sha256 in seen:
            run.copies += 1
            continue
        if content.sha256:
            seen.add(content.sha256)
        tasks = [Task(location, content, case) for case in (cases[:1] if content.fault else cases)]
        broken = tasks[0].key_if_broken
        if content.sha256 and table.has(broken, limits):
            run.keys.add(broken)
            run.known += 1
            continue
        for task in tasks:
            run.keys.add(task.key)
            if content.sha256 and table.has(task.key, limits):
                run.known += 1
            else:
                yield task


def _compute(task: Task, limits: Limits) -> Rows:
    """Compute a task's rows in a process of the calling thread."""
    try:
        rows = limited(limits, rows_of, task)
    except (TooSlowError, CrashedError) as error:
        rows = task.rows("slow" if isinstance(error, TooSlowError) else "crashed", error.cause)
    rows.motion.limits = str(limits)
    return rows


def _results(pairs: Sequence[tuple[Task, Future[Rows]]], run: LibraryRun) -> Iterator[Rows]:
    for task, future in pairs:
        if fault := _fault(future):
            run.lost[task.location] = fault
            continue
        rows = future.result()
        run.keys.discard(task.key)
        if (key := rows.motion.key) not in run.keys:  # a broken file has one row for all its cases
            run.keys.add(key)
            yield rows


def _fault(future: Future[Any]) -> str:
    """The reason why a call failed, for reports on the scheduler; "" if it succeeded."""
    if future.cancelled():
        return "cancelled"
    error = future.exception()
    return f"{type(error).__name__}: {error}" if error else ""


T = TypeVar("T")
R = TypeVar("R")

#: Most pending calls; with a scheduler of 1,000 cores four for each.
_WINDOW: Final = 4096
#: Results within this time are returned together, s, because writing a row alone takes 10 ms.
_TOGETHER: Final = 0.25
#: Timeout for an answer of the scheduler, and for workers to import g1stream, s.
_TIMEOUT: Final = 10.0
_START: Final = 60.0
#: Time between checks whether to stop, s.
_POLL: Final = 0.2


@contextmanager
def open_executor(
    workers: int,
    cluster: str | None = None,
    *,
    insecure: bool = False,
    warn: Callable[[str], None] = lambda text: None,
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[Executor]:
    """Open the executor for the calls.

    Args:
        workers: number of processes on this machine.
        cluster: address of a Dask scheduler to use instead, such as `tls://host:8786`.
        insecure: as of `run_library`.
        warn: called with the reason for waiting, and a remedy.
        stop: polled; True ends the wait for workers.

    Raises:
        ConfigError: the extra `cluster` is not installed, the scheduler may not be trusted, there
            is none, or its workers lack g1stream or have another version.
    """
    if cluster:
        _require_trusted(cluster, insecure=insecure)
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
        while joining.is_alive():  # repeatedly, because a process may just be starting
            end_processes()
            joining.join(_POLL)


def _require_trusted(cluster: str, *, insecure: bool) -> None:
    """Refuse a scheduler elsewhere whose messages anybody on the way can replace."""
    scheme, _, rest = cluster.rpartition("://")
    host = rest.rpartition(":")[0].strip("[]") or rest
    with suppress(ValueError):
        insecure |= ip_address(host).is_loopback
    if insecure or host == "localhost" or scheme == "tls":
        return
    raise ConfigError(
        f"The scheduler {cluster} is on another machine, and is asked for without TLS: whoever "
        "can answer in its place runs code here and on the workers.",
        "Give tls://HOST:PORT with certificates (docs/scale.md), or --cluster-insecure in a "
        "network of your own.",
    )


def _in_time(call: Callable[[], T], seconds: float) -> T:
    """Call a function of Dask, whose own timeouts do not cover a peer that never answers.

    It has a thread of its own because this thread may have a notebook's event loop.
    """
    result: Future[T] = Future()

    def run() -> None:
        try:
            result.set_result(call())
        except BaseException as error:
            result.set_exception(error)

    Thread(target=run, name="cluster", daemon=True).start()
    if not wait([result], seconds).done:
        raise OSError(f"no answer within {seconds:g} s")
    return result.result()


@contextmanager
def _client(cluster: str, warn: Callable[[str], None], stop: Callable[[], bool]) -> Iterator[Any]:
    distributed = import_extra("distributed", "cluster", "--cluster needs")
    try:
        _in_time(lambda: asyncio.run(_connected(cluster)), _TIMEOUT)
        make = partial(distributed.Client, cluster, timeout=_TIMEOUT, set_as_default=False)
        client = _in_time(make, 2.0 * _TIMEOUT)
    except Exception as error:  # what is no scheduler may answer anything
        if cluster.startswith("tls://") and isinstance(error, TypeError):
            raise ConfigError(
                f"The Dask scheduler {cluster} needs TLS certificates: {error}.",
                "Set them in Dask's configuration, distributed.comm.tls.",
            ) from error
        raise ConfigError(
            f"There is no Dask scheduler at {cluster}: {error}.",
            "Start one with `dask scheduler`, and give the address that it prints.",
        ) from error
    with client:
        try:
            if not _in_time(client.nthreads, _TIMEOUT):
                warn(
                    f"The scheduler {cluster} has no workers: waiting for workers. Start them with "
                    f"`dask worker {cluster}`, one for each machine."
                )
            while not _in_time(client.nthreads, _TIMEOUT) and not stop():
                time.sleep(_POLL)
            versions = set(_in_time(partial(client.run, _version), _START).values()) - {__version__}
        except Exception as error:  # any error of the scheduler or a worker
            raise ConfigError(
                f"The workers of {cluster} cannot run g1stream: {error}.",
                "Install g1stream on each of them.",
            ) from error
        if versions:
            raise ConfigError(
                f"Workers of {cluster} have g1stream {', '.join(sorted(versions))}.",
                f"Install g1stream {__version__} on each of them.",
            )
        yield client


async def _connected(cluster: str) -> None:
    """Connect once. An unconnected Client waits 20 s when deleted, and prints a traceback."""
    from distributed.comm import connect
    from distributed.security import Security

    security = Security().get_connection_args("client")
    comm = await connect(cluster, timeout=_TIMEOUT, **security)
    await comm.close()


def _version() -> str:
    return __version__


def completed(
    executor: Executor,
    function: Callable[[T], R],
    items: Iterable[T],
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[list[tuple[T, Future[R]]]]:
    """Call a function with each item; yields completed calls, some together.

    Args:
        executor: executor of the calls.
        function: called with an item.
        items: consumed as calls are completed, so there may be many.
        stop: polled; True ends without waiting for pending calls.
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
    """Whether its Dask client is closed. Pending results are then never set."""
    client = getattr(executor, "_client", None)
    return client is not None and client.status == "closed"
