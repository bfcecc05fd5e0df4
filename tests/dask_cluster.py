"""A Dask cluster on this machine."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def dask_cluster(
    workers: int = 1, threads: int = 1
) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """Run a scheduler and workers on loopback, started as in docs/scale.md.

    Args:
        workers: number of workers.
        threads: number of threads of each.

    Yields:
        The scheduler's address, its process, and the processes that started the workers.
    """
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory, "scheduler.json")

        def start(*arguments: str) -> subprocess.Popen[bytes]:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments, "--no-dashboard"],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )

        head = start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file)
        )
        many: list[subprocess.Popen[bytes]] = []
        try:
            # The file exists before it is written; its last line is the outermost brace.
            while not (file.exists() and file.read_text().endswith("\n}")):
                if head.poll() is not None:
                    raise RuntimeError(f"dask scheduler ended with code {head.returncode}")
                time.sleep(0.05)
            address = json.loads(file.read_text())["address"]
            worker = ("worker", address, "--host", "127.0.0.1", "--nthreads", str(threads))
            many += [start(*worker) for _ in range(workers)]
            yield address, head, many
        finally:
            for process in (*many, head):
                process.kill()  # a worker that is terminated waits for its scheduler
                process.wait()
