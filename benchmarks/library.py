"""A library of many motions: throughput, overhead of a motion, growth, memory.

    python benchmarks/library.py [--motions 100 300 1000] [--workers 2] [--cluster] [--json]

`g1stream library check` of short cuts of the bundled motion, all different (trimmed, mirrored, at
other speeds): with one process and with several, and of each number of motions. With --cluster also
by the workers of a Dask scheduler on this machine. The overhead of a motion is the time of the
processes less what computing it took, as its row says.

motions_per_s, efficiency (against as many single processes), overhead_ms and linear_r2 (of time
over number) are of the several processes; those of Dask have `dask_` before them. With --hour an
hour of motion is checked as one file.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import g1stream
from g1stream.library.processes import Limits
from g1stream.testing import dask_cluster


def make(directory: Path, n: int, seconds: float) -> None:
    """Write so many different motions of that length."""
    demo, rng = g1stream.load_motion("demo"), np.random.default_rng(0)
    directory.mkdir()
    for i in range(n):
        start = rng.uniform(0.0, demo.duration - seconds)
        motion = demo.trim(start, start + seconds).at_speed(float(rng.uniform(0.9, 1.1)))
        motion = motion.mirrored() if i % 2 else motion
        motion.save(directory / f"{i:06}.npz")


def check(motions: list[Path], out: Path, **where: Any) -> dict[str, Any]:
    """Check motions, and return time and memory."""
    begun = time.perf_counter()
    run = g1stream.run_library(
        [str(path) for path in motions],
        [g1stream.LibraryCase("check", out)],
        limits=Limits(megabytes=8000.0),
        **where,
    )
    whole = time.perf_counter() - begun
    rows = g1stream.open_library(out).motions
    assert run.complete, run.lost
    assert (rows["status"] == "ok").all()
    return {
        "motions": len(motions),
        "whole_s": whole,  # with the start of processes, looking for files, and the page
        "seconds": run.elapsed,
        "computing_s": float(rows["seconds"].sum()),
        "memory_mb": rows["memory"].tolist(),
    }


def resident_mb(pid: int) -> float:
    """Memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def overhead_ms(run: dict[str, Any], workers: int) -> float:
    """Time of the processes for a motion beyond computing it."""
    beyond = run["seconds"] * workers - run["computing_s"]
    return float(1e3 * beyond / run["motions"])


def linear_r2(runs: list[dict[str, Any]]) -> float:
    """Of a straight line through time over number of motions."""
    n, seconds = (np.array([run[key] for run in runs]) for key in ("motions", "seconds"))
    residual = seconds - np.polyval(np.polyfit(n, seconds, 1), n)
    return 1.0 - float(residual.var()) / float(seconds.var())


def hour(root: Path) -> float:
    """Seconds to check an hour of motion at 30 fps, as one file."""
    motion = g1stream.load_motion("demo").looped(400).trim(0.0, 3600.0)
    motion.save(root / "hour.npz")
    return float(check([root / "hour.npz"], root / "hour", workers=1)["computing_s"])


def measure(flags: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    numbers, workers, seconds = sorted(flags.motions), flags.workers, flags.seconds
    with tempfile.TemporaryDirectory() as directory:
        root = Path(directory)
        make(root / "motions", max(numbers), seconds)
        motions = sorted((root / "motions").iterdir())
        one = check(motions[: numbers[0]], root / "one", workers=1)
        several = [check(motions[:n], root / f"several-{n}", workers=workers) for n in numbers]
        most = several[-1]
        grown = np.array(most["memory_mb"])
        tenth = max(1, len(grown) // 10)
        rate = most["motions"] / most["seconds"]
        found: dict[str, Any] = {
            "seconds_each": seconds,
            "workers": workers,
            "check_ms": 1e3 * one["computing_s"] / one["motions"],
            "motions_per_s": rate,
            "efficiency": rate / (workers * one["motions"] / one["computing_s"]),
            "overhead_ms": overhead_ms(most, workers),
            "linear_r2": linear_r2(several) if len(several) > 2 else None,
            "worker_mb": float(grown[-tenth:].max()),
            "worker_growth_mb": float(
                np.median(grown[-tenth:]) - np.median(grown[tenth : 2 * tenth])
            ),
            "runs": [{k: run[k] for k in ("motions", "whole_s", "seconds")} for run in several],
        }
        if flags.hour:
            found["hour_check_s"] = hour(root)
        if flags.cluster:
            with dask_cluster(workers) as (address, head, _):
                check(motions[:workers], root / "warm", cluster=address)
                before = resident_mb(head.pid)
                dask = check(motions, root / "dask", cluster=address)
                found |= {
                    "dask_motions_per_s": dask["motions"] / dask["seconds"],
                    "dask_overhead_ms": overhead_ms(dask, workers),
                    "dask_scheduler_mb": resident_mb(head.pid),
                    "dask_scheduler_growth_mb": resident_mb(head.pid) - before,
                }
        return found


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--motions", type=int, nargs="+", default=[100, 300, 1000])
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--cluster", action="store_true")
    parser.add_argument("--hour", action="store_true", help="check an hour of motion, too")
    parser.add_argument("--json", action="store_true")
    flags = parser.parse_args()
    found = measure(flags)
    if flags.json:
        print(json.dumps(found, indent=2))
        return
    for name, value in found.items():
        if name != "runs":
            print(f"{name:<26}{value:10.4g}" if value is not None else f"{name:<26}{'':>10}")
    for run in found["runs"]:
        print("".join(f"{key} {value:.1f}  " for key, value in run.items()))


if __name__ == "__main__":
    main()
