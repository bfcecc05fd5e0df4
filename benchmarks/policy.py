"""How late commands may come: a policy's motion on free feet, against an added delay and noise.

    python benchmarks/policy.py POLICY.onnx [...] --motion dance.csv [--runs 10] [--json]

Each policy plays the motion in lockstep with the simulated robot, with each delay that is added to
its commands (`sim.command_delay`), without noise and with it (`sim.noise` 1). With noise there are
so many runs, each of another seed (`sim.seed`); without it all would be the same. A cell is the
RMSE of all joints and, where not all runs came to the end, how many did and the mean time that the
others survived. Time counts from the beginning of PLAY, `stream.stand` of standing included.

It is `g1stream library simulate` with a sweep: with --out the rows are kept there, and the same
command goes on where it was ended.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
from pathlib import Path
from typing import Any

import g1stream
from g1stream.config import load_config
from g1stream.extras.library.compute import LibraryCase
from g1stream.extras.library.library_cli import swept
from g1stream.extras.library.workers import Limits

DELAYS = (0.0, 0.004, 0.008, 0.012, 0.016, 0.020)


def cases(policies: list[str], delays: list[float], runs: int, out: Path) -> list[LibraryCase]:
    """One for each row: policy, delay, noise and seed."""
    found = []
    for policy in policies:
        config = load_config(over={"stream.policy": str(Path(policy).absolute())})
        delay = "sim.command_delay=" + ",".join(map(str, delays))
        for noise, seeds in ((0, [0]), (1, range(runs))):
            sweeps = [delay, f"sim.noise={noise}", "sim.seed=" + ",".join(map(str, seeds))]
            found += [
                LibraryCase("simulate", out, settings, "free", values)
                for values, settings in swept(config, sweeps)
            ]
    return found


def pooled(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What several runs of one policy, delay and noise have in common."""
    refused = [row["reason"] for row in rows if row["status"] != "ok"]
    if refused:
        return {"refused": refused[0]}
    ended = [row for row in rows if row["completed"] is not True]
    return {
        "runs": len(rows),
        "completed": len(rows) - len(ended),
        "sonic": sum(row["success_sonic"] is True for row in rows),
        "survived_s": statistics.mean(row["survived"] for row in rows),
        "ended_at_s": statistics.mean(row["survived"] for row in ended) if ended else None,
        "ended": sorted({row["ended"] for row in ended}),
        "rmse_rad": statistics.mean(row["rmse"] for row in rows),
    }


def cell(of: dict[str, Any]) -> str:
    """RMSE, and how many runs ended early."""
    if "refused" in of:
        return str(of["refused"])
    text = f"{of['rmse_rad']:.3f}"
    if of["ended_at_s"] is None:
        return text
    several = f"{of['completed']} of {of['runs']}, " if of["runs"] > 1 else ""
    return f"{text} ({several}ended at {of['ended_at_s']:.0f} s)"


def main() -> None:
    """Parse, simulate, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="ONNX file")
    parser.add_argument("--motion", required=True, help="motion file, or a bundled motion")
    parser.add_argument("--seconds", type=float, help="play only the first ones of the motion")
    parser.add_argument("--delays", type=float, nargs="+", default=DELAYS, metavar="S")
    parser.add_argument("--runs", type=int, default=1, help="of each with noise, one a seed")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, help="library that keeps the rows")
    parser.add_argument("--json", action="store_true")
    flags = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        motion = g1stream.load_motion(flags.motion)
        if flags.seconds is not None:
            motion = motion.trim(0.0, flags.seconds)
        path = Path(temporary, f"{motion.name}.npz")
        motion.save(path)
        asked = cases(flags.policies, flags.delays, flags.runs, flags.out or Path(temporary, "out"))
        run = g1stream.library.run_library(
            [str(path)], asked, workers=flags.workers, limits=Limits(3600.0, 8000.0)
        )
        if not run.complete:
            raise SystemExit(f"not computed: {run.lost}")
        library = g1stream.library.open_library(asked[0].out)
    asked_for = library.motions[library.motions["key"].isin(run.keys)]
    rows = {row["variant"]: row for row in asked_for.to_dict("records")}
    kinds: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for one in asked:
        name = f"{one.policy}, noise" if one.sweep["sim.noise"] else f"{one.policy}"
        key = name, one.variant.split()[1], float(one.sweep["sim.command_delay"])
        kinds.setdefault(key, []).append(rows[one.variant])
    found = {key: pooled(of) for key, of in kinds.items()}
    if flags.json:
        told = [{"policy": name, "delay_s": s, **of} for (name, _, s), of in found.items()]
        print(json.dumps(told, indent=2))
        return
    print("| RMSE, rad | " + " | ".join(f"{1e3 * s:g} ms" for s in flags.delays) + " |")
    print("|---" * (1 + len(flags.delays)) + "|")
    for name, file in dict.fromkeys((name, file) for name, file, _ in found):
        cells = (cell(found[name, file, s]) for s in flags.delays)
        print(f"| {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
