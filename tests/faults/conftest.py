"""Run several rows of the table at once: they mostly wait."""

from __future__ import annotations

import queue
import sys
import tempfile
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from engine import AT_ONCE, Fault, play
from forked import start_server
from judge import Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@pytest.fixture(scope="module")
def outcome_of(request, tmp_path_factory, claim_domain) -> Iterator[Callable[[Fault], Outcome]]:
    """The outcome of a row. All rows that are selected begin with the first, but those that run
    alone."""
    domains: queue.SimpleQueue[int] = queue.SimpleQueue()
    for _ in range(AT_ONCE):
        domains.put(claim_domain())

    folder = tmp_path_factory.mktemp("faults")

    def run(fault: Fault) -> Outcome:
        domain = domains.get()
        try:
            return play(fault, domain, Path(tempfile.mkdtemp(dir=folder)))
        finally:
            domains.put(domain)

    rows = [
        i.callspec.params["fault"] for i in request.session.items if "outcome_of" in i.fixturenames
    ]
    start_server()
    with ThreadPoolExecutor(AT_ONCE) as pool:
        running: dict[str, Future[Outcome]] = {
            row.name: pool.submit(run, row) for row in rows if not (row.alone or row.impossible)
        }

        def outcome(fault: Fault) -> Outcome:
            if fault.alone:
                wait(running.values())
                return run(fault)
            return running[fault.name].result()

        yield outcome
        pool.shutdown(cancel_futures=True)
