"""Lateness of LowCmd against its absolute deadline: `g1stream stream` beside the SDK's way.

    python benchmarks/loop.py [--seconds 60] [--json]

Our bridge and a recorder run all the time on the same machine, and the two sides take turns: ours
is the real command with a looping motion, the SDK's a RecurrentThread with its publisher and a
subscriber with a handler. A tick that comes a whole period late or more is skipped by both, and
counted apart. Beside each run goes a thread with our rights that does nothing but sleep until each
deadline: what it misses meanwhile, this machine took.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import sides

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

PERCENTILES = (50.0, 99.0, 99.9)
RATES = (500, 1000)
FAST = 2000


def stream(domain: int, rate: int, seconds: float, *more: str) -> dict[str, Any]:
    """One run of ours, with more flags if given, and the CPU of its middle."""
    flags = [f"--domain={domain}", f"--rate={rate}", f"--duration={seconds}", "--ramp=1", *more]
    process = subprocess.Popen(
        [*sides.G1STREAM, "stream", "demo", "--loop", "--json", *flags],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=sides.clean_environment(),
    )
    time.sleep(3.0)
    cpu, wall = cpu_of(process.pid), time.monotonic()
    time.sleep(max(1.0, seconds - 3.0))
    share = 100.0 * (cpu_of(process.pid) - cpu) / (time.monotonic() - wall)
    out, _ = process.communicate(timeout=60)
    loop = json.loads(out)["stream"]
    return {
        "cpu_percent": None if loop["reason"] else share,  # it may have ended long ago
        "commands": loop["commands"],
        "skipped": loop["skipped_ticks"],
        "max_us": loop["lateness_us"]["max"],
        "histogram_us": loop["lateness_histogram_us"],
        "reason": loop["reason"],
        "realtime": loop["realtime"],
    }


def cpu_of(pid: int) -> float:
    """CPU time of a process and its threads so far, s (proc(5): utime and stime)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def merged(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Several runs of one side as one."""
    histogram: Counter[int] = Counter()
    for one in runs:
        histogram.update({int(late): count for late, count in one["histogram_us"].items()})
    shares = [one["cpu_percent"] for one in runs if one["cpu_percent"] is not None]
    return {
        "realtime": runs[0].get("realtime"),
        "ended_by": [one["reason"] for one in runs if one.get("reason")],
        "commands": sum(one["commands"] for one in runs),
        "skipped": sum(one["skipped"] for one in runs),
        "cpu_percent": sum(shares) / len(shares) if shares else None,
        "lateness_us": {
            **{f"p{p:g}": sides.percentile(histogram, p) for p in PERCENTILES},
            "max": max(one["max_us"] for one in runs),
        },
    }


def measure(domain: int, rounds: int, seconds: float) -> dict[str, Any]:
    """All figures, by rate and side."""
    sdk = sides.sdk()
    found: dict[str, Any] = {}
    with (
        tempfile.TemporaryDirectory() as directory,
        sides.beside([*sides.G1STREAM, "sim", f"--domain={domain}"]),
        sides.beside(
            [*sides.G1STREAM, "record", "-o", f"{directory}/x.mcap", f"--domain={domain}"]
        ),
    ):
        for rate in RATES:
            flags = [f"--domain={domain}", f"--rate={rate}", f"--seconds={seconds}"]
            players = {
                "ours": partial(stream, domain, rate, seconds),
                "sdk": partial(sides.result_of, [*sdk, "run", *flags]),
            }
            found[str(rate)] = in_turns(players, rate, rounds, seconds)
        found[str(FAST)] = in_turns(
            {"ours": partial(stream, domain, FAST, seconds)}, FAST, 1, seconds
        )
    return found


def in_turns(
    players: Mapping[str, Callable[[], dict[str, Any]]], rate: int, rounds: int, seconds: float
) -> dict[str, Any]:
    """Figures of each player, and under its name and `_alone` those of the deadlines meanwhile."""
    runs: dict[str, list[dict[str, Any]]] = {}
    alone = [*sides.OURS, "floor", f"--rate={rate}", f"--seconds={seconds}"]
    with ThreadPoolExecutor(1) as beside:
        for _ in range(rounds):
            for side, play in players.items():
                meanwhile = beside.submit(sides.result_of, alone)
                runs.setdefault(side, []).append(play())
                runs.setdefault(f"{side}_alone", []).append(meanwhile.result())
    return {side: merged(of) for side, of in runs.items()}


def table(found: dict[str, Any]) -> str:
    """The figures as text."""
    names = {
        "ours": "g1stream",
        "ours_alone": "  deadlines alone",
        "sdk": "SDK",
        "sdk_alone": "  deadlines alone",
    }
    columns = [f"p{p:g}" for p in PERCENTILES] + ["max"]
    lines = [
        f"{'lateness, us':<26}"
        + "".join(f"{column:>9}" for column in columns)
        + f"{'skipped':>9}{'commands':>10}{'CPU %':>7}"
    ]
    for rate in map(str, (*RATES, FAST)):
        for side, figures in found[rate].items():
            cpu = figures["cpu_percent"]
            lines.append(
                f"{rate + ' Hz  ' + names[side]:<26}"
                + "".join(f"{figures['lateness_us'][column]:9.0f}" for column in columns)
                + f"{figures['skipped']:9d}{figures['commands']:10d}"
                + (f"{cpu:7.1f}" if cpu is not None else "")
            )
            lines += [f"{'':10}ended early: {reason}" for reason in figures["ended_by"]]
        if "sdk" in found[rate]:
            ratio = ratios(found[rate])
            lines.append(
                f"{rate + ' Hz  g1stream / SDK':<26}" + "".join(f"{ratio[c]:9.2f}" for c in columns)
            )
    granted = ", ".join(
        f"{one['what']} {one['detail'] if one['granted'] else 'not granted'}"
        for one in found[str(RATES[0])]["ours"]["realtime"]
    )
    return "\n".join([*lines, f"granted: {granted}", sides.load()])


def ratios(both: dict[str, Any]) -> dict[str, float]:
    """Our lateness as a share of the SDK's, by percentile."""
    ours, theirs = both["ours"]["lateness_us"], both["sdk"]["lateness_us"]
    return {column: ours[column] / theirs[column] for column in ours}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--domain", type=int, default=88)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = measure(args.domain, args.rounds, args.seconds)
    slowest = str(RATES[0])
    found["p999_ratio"] = ratios(found[slowest])["p99.9"]
    found["missed"] = found[slowest]["ours"]["skipped"]
    found["missed_by_deadlines_alone"] = found[slowest]["ours_alone"]["skipped"]
    print(json.dumps(found, indent=2) if args.json else table(found))


if __name__ == "__main__":
    main()
