"""A library of many motions: throughput, overhead of a motion, growth, memory.

    python benchmarks/library.py [--motions 100 300 1000] [--workers 2] [--json]

`g1stream library check` of short cuts of the bundled motion, all different (trimmed, mirrored, at
other speeds): with one worker, and of each number of motions with several. The overhead of a motion
is the time of the workers less what computing it took, as its row says.

efficiency is against as many single workers, linear_r2 of time over number. command_ms is the CPU
time of the command for a motion, with that of Dask's scheduler, which runs in it. command_mb is its
memory before, and after each tenth of the most motions. With --root a library is computed in pieces
of some minutes. With --hour an hour of a motion, such as demo, is checked as one file.
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
from g1stream.extras.library.compute import Task, contents_of, rows_of
from g1stream.extras.library.workers import Limits


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
    begun, spent = time.perf_counter(), time.process_time()
    run = g1stream.library.run_library(
        [str(path) for path in motions],
        [g1stream.library.LibraryCase("check", out)],
        limits=Limits(megabytes=8000.0),
        **where,
    )
    whole, spent = time.perf_counter() - begun, time.process_time() - spent
    rows = g1stream.library.open_library(out).motions
    assert run.complete, run.lost
    assert (rows["status"] == "ok").all()
    return {
        "motions": len(motions),
        "command_ms": 1e3 * spent / len(motions),
        "whole_s": whole,  # with the start of processes, and looking for files
        "seconds": run.elapsed,
        "computing_s": float(rows["seconds"].sum()),
        "memory_mb": rows["memory"].tolist(),
    }


def piece(root: Path, n: int, seconds: float, workers: int, minutes: float) -> dict[str, Any]:
    """Go on for some minutes with a library of so many motions; what this piece took."""
    begun = time.perf_counter()
    if not (root / "motions").exists():
        make(root / "motions", n, seconds)
    spent = time.process_time()
    run = g1stream.library.run_library(
        [str(root / "motions")],
        [g1stream.library.LibraryCase("check", root / "library")],
        workers=workers,
        stop=lambda: time.perf_counter() - begun > 60.0 * minutes,
    )
    spent, memory = time.process_time() - spent, resident_mb(os.getpid())
    rows = g1stream.library.open_library(root / "library").motions
    new = rows.tail(run.done)
    return {
        "known": run.known,
        "done": run.done,
        "seconds": run.elapsed,
        "motions_per_s": run.done / run.elapsed,
        "check_ms": 1e3 * float(new["seconds"].mean()),
        "overhead_ms": 1e3 * (run.elapsed * workers - float(new["seconds"].sum())) / run.done,
        "command_ms": 1e3 * spent / run.done,
        "command_mb": memory,
        "worker_mb": float(new["memory"].max()),
        "load": os.getloadavg()[1],
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


def hour(name: str, root: Path) -> float:
    """CPU time, s, to check an hour of motion, as one file: a motion again and again."""
    motion, path = g1stream.load_motion(name), str(root / "hour.npz")
    motion.looped(1 + int(3600.0 / motion.duration)).trim(0.0, 3600.0).save(path)
    ((_, content),) = contents_of(path)
    begun = time.process_time()
    rows = rows_of(Task(path, content, g1stream.library.LibraryCase("check", root / "hour")))
    assert rows.motion.status == "ok", rows.motion.reason
    return time.process_time() - begun


def measure(flags: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    numbers, workers, seconds = sorted(flags.motions), flags.workers, flags.seconds
    with tempfile.TemporaryDirectory() as directory:
        root = Path(directory)
        make(root / "motions", max(numbers), seconds)
        motions = sorted((root / "motions").iterdir())
        one = check(motions[: numbers[0]], root / "one", workers=1)
        found: dict[str, Any] = {
            "seconds_each": seconds,
            "workers": workers,
            "check_ms": 1e3 * one["computing_s"] / one["motions"],
        }
        if flags.hour:
            found["hour_cpu_s"] = hour(flags.hour, root)
        single = workers * one["motions"] / one["computing_s"]
        held = [resident_mb(os.getpid())]
        hold = lambda _: held.append(resident_mb(os.getpid()))  # noqa: E731
        several = [
            check(motions[:n], root / f"several-{n}", workers=workers, on_row=hold) for n in numbers
        ]
        most, tenth = held[-numbers[-1] :], max(1, numbers[-1] // 10)
        found["command_mb"] = [held[0], *most[tenth - 1 :: tenth]]
        return found | figures(several, workers, single)


def figures(runs: list[dict[str, Any]], workers: int, single: float) -> dict[str, Any]:
    """What runs of several numbers of motions say; `single` are the motions a second at best."""
    most = runs[-1]
    grown = np.array(most["memory_mb"])
    tenth = max(1, len(grown) // 10)
    rate = most["motions"] / most["seconds"]
    return {
        "motions_per_s": rate,
        "efficiency": rate / single,
        "overhead_ms": overhead_ms(most, workers),
        "command_ms": most["command_ms"],
        "linear_r2": linear_r2(runs) if len(runs) > 2 else None,
        "worker_mb": float(grown[-tenth:].max()),
        "worker_growth_mb": float(np.median(grown[-tenth:]) - np.median(grown[tenth : 2 * tenth])),
        "runs": [{k: run[k] for k in ("motions", "whole_s", "seconds")} for run in runs],
    }


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--motions", type=int, nargs="+", default=[100, 300, 1000])
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--hour", metavar="MOTION", help="check an hour of this motion, too")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--root", type=Path, help="keep the most motions here, and go on there")
    parser.add_argument("--minutes", type=float, default=5.0, help="end then, with --root")
    flags = parser.parse_args()
    if flags.root:
        most = max(flags.motions)
        one = piece(flags.root, most, flags.seconds, flags.workers, flags.minutes)
        print(json.dumps(one, indent=2))
        return
    found = measure(flags)
    if flags.json:
        print(json.dumps(found, indent=2))
        return
    for name, value in found.items():
        if isinstance(value, float | int):
            print(f"{name:<26}{value:10.4g}")
    print(f"{'command_mb':<26}{' '.join(f'{one:.0f}' for one in found['command_mb'])}")
    for run in found["runs"]:
        print("".join(f"{key} {value:.1f}  " for key, value in run.items()))


if __name__ == "__main__":
    main()
