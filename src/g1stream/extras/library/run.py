"""Computes a library: finds motions, skips known rows, computes and writes the others."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from g1stream.errors import ConfigError
from g1stream.extras.library.compute import Content, Task, contents_of, rows_of
from g1stream.extras.library.files import find_motions
from g1stream.extras.library.table import writing
from g1stream.extras.library.workers import (
    CrashedError,
    Limits,
    TooSlowError,
    completed,
    open_workers,
)
from g1stream.text import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from concurrent.futures import Future

    from g1stream.extras.library.compute import LibraryCase
    from g1stream.extras.library.table import MotionRow, Rows, Status, TableWriter

__all__ = ["LibraryRun", "run_library"]


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
    """Compute the rows of all motions below some places, write them continuously.

    Existing rows with the same content, settings and versions are not computed again. Written rows
    are kept however the run ends, and the same call continues it.

    Args:
        places: directories and files.
        cases: computations for each motion, all with the same directory.
        workers: number of processes on this machine; one for each CPU if None. They import the main
            module of a program again, which must call this below `if __name__ == "__main__":`.
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
        open_workers(
            workers or os.cpu_count() or 1, cluster, insecure=insecure, warn=warn, stop=stop
        ) as client,
    ):
        contents = list(_contents(client, locations, run, stop))
        tasks: list[Task] = []
        if not stop():
            tasks += _tasks(contents, cases, table, str(limits), run)
            run.computing = True
        started = time.monotonic()
        for pairs in completed(client, rows_of, tasks, limits, stop):
            written = list(_results(pairs, limits, run))
            if written:
                table.add(written)
            run.elapsed = time.monotonic() - started
            for rows in written:
                run.done += 1
                run.failed += rows.motion.status != "ok"
                on_row(rows.motion)
    return run


def _require_apart(places: Sequence[str], out: Path) -> None:
    """Refuse a library's directory that contains motions, because it is not searched for them."""
    for place in places:
        path = Path(place).resolve()
        if path.exists() and out.resolve() in (path, *path.parents):
            raise ConfigError(
                f"The library {out} would contain the motions in {place}, and hide them.",
                "Choose another directory for the library.",
            )


def _contents(
    client: Any, locations: list[str], run: LibraryRun, stop: Callable[[], bool]
) -> Iterator[tuple[str, Content]]:
    """The content at each location."""
    for pairs in completed(client, contents_of, locations, stop=stop):
        for location, future in pairs:
            run.hashed += 1
            if crashed := _crashed(future):
                yield location, Content("", crashed.cause)
            elif fault := _fault(future):
                run.lost[location] = fault
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


def _results(
    pairs: Sequence[tuple[Task, Future[Rows]]], limits: Limits, run: LibraryRun
) -> Iterator[Rows]:
    for task, future in pairs:
        if crashed := _crashed(future):
            status: Status = "slow" if isinstance(crashed, TooSlowError) else "crashed"
            rows = task.rows(status, crashed.cause)
        elif fault := _fault(future):
            run.lost[task.location] = fault
            continue
        else:
            rows = future.result()
        rows.motion.limits = str(limits)
        run.keys.discard(task.key)
        if (key := rows.motion.key) not in run.keys:  # a broken file has one row for all its cases
            run.keys.add(key)
            yield rows


def _crashed(future: Future[Any]) -> TooSlowError | CrashedError | None:
    """Why the worker of a call ended."""
    error = None if future.cancelled() else future.exception()
    return error if isinstance(error, (TooSlowError, CrashedError)) else None


def _fault(future: Future[Any]) -> str:
    """The reason why a call failed, for reports on the scheduler; "" if it succeeded."""
    if future.cancelled():
        return "cancelled"
    error = future.exception()
    return f"{type(error).__name__}: {error}" if error else ""
