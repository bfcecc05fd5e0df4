"""Summary, metrics and report of ten minutes at 500 Hz: time and memory, and how they grow.

    python benchmarks/report.py [--minutes N] [--json]

A synthetic session (`g1stream.synthetic`) of N minutes, and one of half that length, are written to
temporary files; summary, metrics and the page of a report are made of each, in processes of
their own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any


def write(path: Path, seconds: float) -> None:
    """Write a session of that length."""
    from g1stream.session.writer import SessionWriter
    from g1stream.synthetic import SyntheticSession

    with SessionWriter(path) as writer:
        SyntheticSession(seconds, delay=0.012, noise=1e-3, torque=1.0).write(writer)


def read(path: Path, what: str) -> dict[str, float]:
    """Open a session and make its `summary`, its `metrics`, or the page of its `report`."""
    from g1stream.analysis.report.page import report
    from g1stream.session.session import open_session

    path.read_bytes()  # so that the disk is not what is measured
    begun, used = time.perf_counter(), time.process_time()
    if what == "report":
        report(path, path.with_suffix(".html"), force=True)
    else:
        getattr(open_session(path), what)()
    return {
        "wall_s": time.perf_counter() - begun,
        "cpu_s": time.process_time() - used,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def measured(path: Path, what: str) -> dict[str, float]:
    """The same, in a process of its own."""
    command = [sys.executable, __file__, "--read", str(path), what]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


def run(minutes: float) -> list[dict[str, Any]]:
    """A row for each length and each of summary, metrics and report."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as directory:
        for length in (minutes / 2, minutes):
            path = Path(directory) / f"{length}.mcap"
            write(path, 60.0 * length)
            rows += [
                {
                    "minutes": length,
                    "size_mb": path.stat().st_size / 1e6,
                    "what": what,
                    **measured(path, what),
                }
                for what in ("summary", "metrics", "report")
            ]
    return rows


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--read", nargs=2, help=argparse.SUPPRESS)
    flags = parser.parse_args()
    if flags.read:
        print(json.dumps(read(Path(flags.read[0]), flags.read[1])))
        return
    rows = run(flags.minutes)
    if flags.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'minutes':>8}{'MB':>8}  {'what':<8}{'wall s':>8}{'CPU s':>8}{'peak MB':>9}")
    for row in rows:
        print(
            f"{row['minutes']:8.1f}{row['size_mb']:8.0f}  {row['what']:<8}{row['wall_s']:8.2f}"
            f"{row['cpu_s']:8.2f}{row['peak_mb']:9.0f}"
        )


if __name__ == "__main__":
    main()
