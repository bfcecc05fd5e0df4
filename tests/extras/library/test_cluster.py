import ctypes
import os
import threading
import time

import pandas as pd
import psutil
import pytest

import g1stream
from dask_cluster import dask_cluster
from g1stream.extras.library.workers import (
    CrashedError,
    Limits,
    TooSlowError,
    completed,
    open_workers,
)

pytestmark = pytest.mark.slow

#: Columns that differ from one run to the next.
COST = ["seconds", "memory"]


def test_the_result_is_that_of_one_machine(checked, motions, tmp_path):
    case = g1stream.library.LibraryCase("check", tmp_path)
    with dask_cluster() as (address, _, _):
        run = g1stream.library.run_library([str(motions)], [case], cluster=address)
    assert run.complete
    here, there = (
        library.motions.sort_values("key").drop(columns=COST).reset_index(drop=True)
        for library in (
            g1stream.library.open_library(checked[1]),
            g1stream.library.open_library(tmp_path),
        )
    )
    pd.testing.assert_frame_equal(here, there)


def test_a_worker_that_is_killed_loses_nothing(many, tmp_path):
    case, killed = g1stream.library.LibraryCase("check", tmp_path), []

    def kill(row):
        if not killed:
            nanny = psutil.Process(workers[0].pid)
            killed.extend(one for one in nanny.children() if "spawn_main" in str(one.cmdline()))
            killed[0].kill()

    with dask_cluster(workers=2) as (address, _, workers):
        run = g1stream.library.run_library([str(many)], [case], cluster=address, on_row=kill)
    assert len(killed) == 1
    assert (run.complete, run.failed, run.lost) == (True, 0, {})
    assert list(g1stream.library.open_library(tmp_path).motions["status"]) == ["ok"] * 120


def test_a_scheduler_without_workers_is_waited_for(motions, tmp_path):
    said = []
    case = g1stream.library.LibraryCase("check", tmp_path)
    with dask_cluster(workers=0) as (address, _, _):
        run = g1stream.library.run_library(
            [str(motions)], [case], cluster=address, warn=said.append, stop=lambda: bool(said)
        )
    assert not run.complete
    assert address in said[0]


def test_a_worker_with_several_threads_is_none(motions, tmp_path):
    said = []
    case = g1stream.library.LibraryCase("check", tmp_path)
    with dask_cluster(workers=1, threads=2) as (address, _, _):
        run = g1stream.library.run_library(
            [str(motions)], [case], cluster=address, warn=said.append, stop=lambda: bool(said)
        )
    assert not run.complete
    assert "--nthreads 1" in said[0]


class SlowToSend:
    def __reduce__(self):
        time.sleep(4.0)
        return str, ()


def test_a_result_that_is_on_its_way_when_the_scheduler_is_killed_is_lost():
    with dask_cluster() as (address, head, _), open_workers(1, address) as client:
        threading.Timer(3.0, head.kill).start()
        ((_, future),) = (
            pair for pairs in completed(client, lambda _: SlowToSend(), [0]) for pair in pairs
        )
    assert future.cancelled() or isinstance(future.exception(), RuntimeError)


def test_the_limits_are_those_of_one_machine():
    def call(what):
        if what == "endless":
            ctypes.PyDLL(None).pause()
        elif what == "abort":
            os.abort()
        return len(bytes(500_000_000 if what == "huge" else 1))

    whats = ["endless", "small", "abort", "huge"]
    with dask_cluster(workers=2) as (address, _, _), open_workers(1, address) as client:
        calls = completed(client, call, whats, Limits(3.0, 200.0))
        found = {what: future.exception() for pairs in calls for what, future in pairs}
    kinds = [type(found[what]) for what in whats]
    assert kinds == [TooSlowError, type(None), CrashedError, MemoryError]


def test_a_scheduler_that_is_killed_ends_the_run_and_keeps_its_rows(many, tmp_path, cluster):
    case = g1stream.library.LibraryCase("check", tmp_path)
    with dask_cluster() as (address, head, _):
        rows = []

        def on_row(row):
            rows.append(row.key)
            if len(rows) == 3:
                threading.Thread(target=head.kill).start()

        run = g1stream.library.run_library([str(many)], [case], cluster=address, on_row=on_row)
    assert not run.complete
    assert run.lost
    kept = g1stream.library.open_library(tmp_path).motions
    assert set(rows) == set(kept["key"])
    # A few of the others are enough: each takes its time.
    others = sorted({str(path) for path in many.iterdir()} - {*kept["path"]})[:10]
    again = g1stream.library.run_library([*kept["path"], *others], [case], cluster=cluster)
    assert (again.complete, again.known, again.done) == (True, len(rows), len(others))
