"""A library on a Dask cluster: the same result as on one machine, whatever ends."""

from __future__ import annotations

import threading

import pandas as pd
import pytest

import g1stream
from g1stream.testing import dask_cluster

pytestmark = pytest.mark.slow

#: Columns that differ from one run to the next.
COST = ["seconds", "memory"]


@pytest.fixture
def many(cuts):
    return cuts(20)


def test_the_result_is_that_of_one_machine(checked, motions, tmp_path):
    case = g1stream.LibraryCase("check", tmp_path)
    with dask_cluster() as (address, _, _):
        run = g1stream.run_library([str(motions)], [case], cluster=address)
    assert run.complete
    here, there = (
        library.motions.sort_values("key").drop(columns=COST).reset_index(drop=True)
        for library in (g1stream.open_library(checked[1]), g1stream.open_library(tmp_path))
    )
    pd.testing.assert_frame_equal(here, there)


def test_a_worker_that_is_killed_loses_nothing(many, tmp_path):
    case = g1stream.LibraryCase("check", tmp_path / "out")
    with dask_cluster(workers=2) as (address, _, workers):
        run = g1stream.run_library(
            [str(many)], [case], cluster=address, on_row=lambda row: workers[0].kill()
        )
    assert (run.complete, run.failed, run.lost) == (True, 0, {})
    assert list(g1stream.open_library(tmp_path / "out").motions["status"]) == ["ok"] * 20


def test_a_scheduler_that_is_killed_ends_the_run_and_keeps_its_rows(many, tmp_path):
    case = g1stream.LibraryCase("check", tmp_path / "out")
    with dask_cluster() as (address, head, _):
        rows = []

        def on_row(row):
            rows.append(row.key)
            if len(rows) == 3:
                threading.Thread(target=head.kill).start()

        run = g1stream.run_library([str(many)], [case], cluster=address, on_row=on_row)
    assert not run.complete
    assert run.lost
    kept = g1stream.open_library(tmp_path / "out").motions["key"]
    assert set(rows) == set(kept)
    again = g1stream.run_library([str(many)], [case], workers=1)
    assert again.complete
    assert (again.known, again.done) == (len(rows), 20 - len(rows))
