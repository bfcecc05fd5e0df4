"""Opening, summary, metrics and report of 1, 2, 5 and 10 minutes at 500 Hz: time, memory, growth.

    python benchmarks/report.py [--minutes N ...] [--json]

A synthetic session (`g1stream.testing`) of each length is written to a temporary file. It is only
opened (`open`), and summary, metrics and the page of a report are made of it, in processes of their
own. Beside them, the stock reader of mcap does nothing but take each message of the same file. The
last column is the CPU time for a minute against that of the shortest session: below 1 where the
cost is less than linear.
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
    from g1stream.testing import SyntheticSession

    with SessionWriter(path) as writer:
        SyntheticSession(seconds, delay=0.012, noise=1e-3, torque=1.0).write(writer)


def read(path: Path, what: str) -> dict[str, float]:
    """`open` a session, make its `summary`, `metrics` or `report`, or `iterate` over it."""
    from mcap.reader import make_reader

    from g1stream.app.session import open_session
    from g1stream.extras.report.page import report

    with path.open("rb") as file:  # so that the disk is not what is measured
        while file.read(2**20):
            pass
    begun, used = time.perf_counter(), time.process_time()
    if what == "open":
        open_session(path)
    elif what == "report":
        report(path, path.with_suffix(".html"), force=True)
    elif what == "iterate":
        with path.open("rb") as file:
            for _ in make_reader(file).iter_messages():
                pass
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


def run(minutes: list[float]) -> list[dict[str, Any]]:
    """A row for each length and each of opening, summary, metrics, report and the stock reader."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as directory:
        for length in minutes:
            path = Path(directory) / f"{length}.mcap"
            write(path, 60.0 * length)
            rows += [
                {
                    "minutes": length,
                    "size_mb": path.stat().st_size / 1e6,
                    "what": what,
                    **measured(path, what),
                }
                for what in ("open", "summary", "metrics", "report", "iterate")
            ]
    shortest = {row["what"]: row["cpu_s"] / row["minutes"] for row in reversed(rows)}
    for row in rows:
        row["per_minute"] = row["cpu_s"] / row["minutes"] / shortest[row["what"]]
    return rows


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, nargs="+", default=[1.0, 2.0, 5.0, 10.0])
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
    print(
        f"{'minutes':>8}{'MB':>8}  {'what':<8}{'wall s':>8}{'CPU s':>8}{'peak MB':>9}{'growth':>8}"
    )
    for row in rows:
        print(
            f"{row['minutes']:8.1f}{row['size_mb']:8.0f}  {row['what']:<8}{row['wall_s']:8.2f}"
            f"{row['cpu_s']:8.2f}{row['peak_mb']:9.0f}{row['per_minute']:8.2f}"
        )


if __name__ == "__main__":
    main()
