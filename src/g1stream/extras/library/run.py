"""A library is computed: what is found, what is known already, and what becomes of the rest."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Final, TypeVar

from g1stream._version import __version__
from g1stream.errors import ConfigError
from g1stream.extras.library.compute import Content, LibraryCase, Task, contents_of, rows_of
from g1stream.extras.library.files import find_motions
from g1stream.extras.library.page import write_page
from g1stream.extras.library.processes import LimitError, Limits, end_processes, limited
from g1stream.extras.library.table import MotionRow, Rows, TableWriter, writing
from g1stream.optional import import_extra
from g1stream.text import counted

__all__ = ["LibraryRun", "completed", "open_executor", "run_library"]

#: Files whose content is looked at in one call.
_BATCH: Final = 32


@dataclass
class LibraryRun:
    """How a run over a library goes, while it goes and afterwards.

    Attributes:
        files: motion files that were found.
        copies: of these, those that are the same as another.
        keys: of the rows that are asked for.
        known: of these, those that were there already.
        done: that were computed.
        failed: of these, those whose motion could not be read, or not be played so.
        hashed: files whose content was looked at.
        lost: why something was not computed, by location: its worker or the scheduler ended.
        computing: whether it is known what is to be computed.
        elapsed: s of computing.
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
        """How many rows are asked for."""
        return len(self.keys)

    @property
    def complete(self) -> bool:
        """Whether all rows that are asked for are there."""
        return self.computing and not self.lost and self.known + self.done == self.total

    def status(self) -> tuple[float | None, str]:
        """What share is done, 0 to 1, and a line of text."""
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
    limits: Limits | None = None,
    run: LibraryRun | None = None,
    on_row: Callable[[MotionRow], None] = lambda row: None,
    stop: Callable[[], bool] = lambda: False,
    warn: Callable[[str], None] = lambda text: None,
) -> LibraryRun:
    """Compute the rows of all motions below some places, write them as they come, then a page.

    Rows that are there already, of the same content, settings and versions, are not computed
    again. Rows that were written stay, however the run ends: the same call goes on there. A script
    that calls this needs `if __name__ == "__main__":`, because its processes import it.

    Args:
        places: directories and files.
        cases: what to compute of each motion, all with the same directory.
        workers: processes on this machine; one for each CPU if None.
        cluster: address of a Dask scheduler whose workers are used instead.
        limits: of time and memory for a row; the defaults if None.
        run: filled while it goes; a new one if None.
        on_row: called with each row that was written.
        stop: asked now and then; whether to end early.
        warn: called with what keeps it waiting: a scheduler that has no workers.

    Returns:
        How it went.

    Raises:
        ConfigError: a place does not exist, or an extra is not installed.
        RecordingError: the library's directory cannot be written, or another process writes to it.
    """
    run, limits = run or LibraryRun(), limits or Limits()
    _require_apart(places, cases[0].out)
    out = cases[0].out.absolute()  # workers on a cluster run in directories of their own
    cases = [replace(case, out=out) for case in cases]
    locations = find_motions(places)
    if not locations:
        raise ConfigError(
            f"There are no motion files below {', '.join(places)}.",
            "docs/formats.md says which files are motions.",
        )
    run.files = len(locations)
    with (
        writing(out) as table,
        open_executor(workers or os.cpu_count() or 1, cluster, warn=warn, stop=stop) as executor,
    ):
        contents = dict(_contents(executor, locations, run, stop))
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
    """A library's directory is not searched for motions, so that it must not hold them."""
    for place in places:
        path = Path(place).resolve()
        if path.exists() and out.resolve() in (path, *path.parents):
            raise ConfigError(
                f"The library {out} would hold the motions in {place}, and hide them.",
                "Choose another directory for the library.",
            )


def _contents(
    executor: Executor, locations: list[str], run: LibraryRun, stop: Callable[[], bool]
) -> Iterator[tuple[str, Content]]:
    """What is in each file that can be told."""
    batches = [locations[i : i + _BATCH] for i in range(0, len(locations), _BATCH)]
    for pairs in completed(executor, contents_of, batches, stop):
        for batch, future in pairs:
            run.hashed += len(batch)
            if fault := _fault(future):
                run.lost |= dict.fromkeys(batch, fault)
            else:
                yield from zip(batch, future.result(), strict=True)


def _tasks(
    contents: dict[str, Content],
    cases: Sequence[LibraryCase],
    table: TableWriter,
    limits: str,
    run: LibraryRun,
) -> Iterator[Task]:
    """What is still to be computed, each content once."""
    seen = set()
    for location in sorted(contents):
        content = contents[location]
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
    """Made where the task is computed, by a thread; the work is that of its process."""
    try:
        rows = limited(limits, rows_of, task)
    except LimitError as error:
        rows = task.rows(error.status, error.cause)
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
    """Why a call came to nothing, which is for the scheduler to say; or "" where it did not."""
    if future.cancelled():
        return "cancelled"
    error = future.exception()
    return f"{type(error).__name__}: {error}" if error else ""


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
    """What calls are submitted to."""
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
    except (OSError, TypeError, ValueError) as error:  # of TLS without certificates, too
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
    """Call a function with each item; yields those that are done, some together."""
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
        elif getattr(getattr(executor, "_client", None), "status", "") == "closed":
            for future in running:  # its result was on its way when the scheduler was lost
                future.cancel()  # which puts it into `done`
    for future in running:
        future.cancel()
