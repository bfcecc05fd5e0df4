"""CPU for one LowCmd out and one LowState in: ours beside the official Python SDK's, in one run.

    python benchmarks/wire.py [--json]

The SDK runs in an environment of its own (tools/make_sdk_env.py). Each operation is measured back
to back, and after a pause of 2 ms, as in a loop at 500 Hz, when the caches hold other things; then
each side as a whole process, threads of DDS included. The checksum is left out on both sides,
because the SDK's wheel lacks the library that computes it; what ours costs is told beside. The row
"sockets alone" is a process that wakes up, sends a datagram of LowCmd's size and receives one of
LowState's, without DDS: less than that no process takes here.
"""

from __future__ import annotations

import argparse
import json
from statistics import median
from typing import Any

import sides

OPERATIONS = ("fill", "write", "take", "decode")
PAUSES = {"back to back": 0.0, "after a pause": 0.002}
RATES = (500, 1000)


def measure(domain: int, rounds: int, seconds: float) -> dict[str, Any]:
    """All figures: medians over rounds in which the sides take turns."""
    commands = {"ours": sides.OURS, "sdk": sides.sdk()}
    operations: dict[str, dict[str, dict[str, float]]] = {}
    processes: dict[str, dict[str, float]] = {}
    with sides.beside([*sides.OURS, "robot", f"--domain={domain}"]):
        for name, pause in PAUSES.items():
            runs: dict[str, list[dict[str, float]]] = {side: [] for side in commands}
            for _ in range(rounds):
                for side, command in commands.items():
                    flags = [f"--domain={domain}", f"--pause={pause}", "--count=1600"]
                    runs[side].append(sides.result_of([*command, "operations", *flags]))
            operations[name] = {
                side: {key: median(one[key] for one in of) for key in of[0]}
                for side, of in runs.items()
            }
    for rate in RATES:
        shares: dict[str, list[float]] = {side: [] for side in (*commands, "sockets")}
        with sides.beside([*sides.OURS, "robot", f"--domain={domain}", f"--rate={rate}"]):
            for _ in range(rounds):
                for side, command in commands.items():
                    flags = [f"--domain={domain}", f"--rate={rate}", f"--seconds={seconds}"]
                    shares[side].append(sides.result_of([*command, "run", *flags])["cpu_percent"])
                alone = sides.result_of([*sides.OURS, "sockets", *flags])
                shares["sockets"].append(alone["cpu_percent"])
        processes[str(rate)] = {side: median(of) for side, of in shares.items()}
    return {"operations_us": operations, "process_cpu_percent": processes}


def ratios(figures: dict[str, Any]) -> dict[str, float]:
    """How many times more CPU the SDK takes."""

    def of(name: str) -> float:
        both = figures["operations_us"][name]
        total = {side: sum(costs[key] for key in OPERATIONS) for side, costs in both.items()}
        return float(total["sdk"] / total["ours"])

    processes = figures["process_cpu_percent"]
    return {
        "cpu_ratio": of("back to back"),
        "cpu_ratio_after_a_pause": of("after a pause"),
        **{f"process_ratio_{rate}": both["sdk"] / both["ours"] for rate, both in processes.items()},
        **{
            f"process_ratio_bound_{rate}": both["sdk"] / both["sockets"]
            for rate, both in processes.items()
        },
    }


def table(figures: dict[str, Any]) -> str:
    """The figures as text."""
    lines = [f"{'CPU per operation, us':<34}{'g1stream':>10}{'SDK':>10}{'ratio':>8}"]

    def row(name: str, ours: float, theirs: float) -> None:
        lines.append(f"{name:<34}{ours:10.2f}{theirs:10.2f}{theirs / ours:8.1f}")

    for name, both in figures["operations_us"].items():
        lines.append(f"{name}:")
        for key in OPERATIONS:
            row(f"  {key}", both["ours"][key], both["sdk"][key])
        row("  together", *(sum(both[side][key] for key in OPERATIONS) for side in ("ours", "sdk")))
        lines.append(f"  (our checksum, left out above: {both['ours']['crc']:.2f})")
    lines.append("CPU of the whole process, % of one core:")
    for rate, both in figures["process_cpu_percent"].items():
        row(f"  {rate} Hz", both["ours"], both["sdk"])
        row(f"  {rate} Hz, sockets alone", both["sockets"], both["sdk"])
    return "\n".join([*lines, sides.load()])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--domain", type=int, default=87)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    figures = measure(args.domain, args.rounds, args.seconds)
    figures |= ratios(figures)
    print(json.dumps(figures, indent=2) if args.json else table(figures))


if __name__ == "__main__":
    main()
