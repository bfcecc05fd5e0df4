"""Every fault of tests/faults, and what the motors of a robot receive then.

    python benchmarks/faults.py [--match TEXT] [--rounds 3] [--domain 80] [--json | --markdown]

A row is a session of `g1stream stream` with a robot that knows nothing of g1stream and records what
it receives. Rows that measure the time from the streamer's last command to the guard's first are
repeated `--rounds` times. `worst_silence_ms` is the longest one, with its row, of a streamer that
was killed or stopped, and `worst_starved_ms` of one that hangs or gets no CPU time on a robot's
interface. On loopback the guard waits for `safety.state_timeout` then, which is in neither figure.
`guard_cpu_percent` is the guard's share of a CPU while the demo is played at 500 Hz.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import re
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import sides

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "faults"))
from engine import AT_ONCE, Fault, Session, play
from forked import start_server
from judge import Outcome
from table import FAULTS

if TYPE_CHECKING:
    from collections.abc import Iterable


def run(faults: Iterable[Fault], first_domain: int, rounds: int) -> list[Outcome]:
    """The outcomes of all rows; of one that is repeated, the worst."""
    domains: queue.SimpleQueue[int] = queue.SimpleQueue()
    for domain in range(first_domain, first_domain + AT_ONCE):
        domains.put(domain)

    def one(fault: Fault) -> Outcome:
        domain = domains.get()
        with tempfile.TemporaryDirectory() as folder:
            try:
                outcome = play(fault, domain, Path(folder))
            finally:
                domains.put(domain)
        told = f"FAILED {fault.name}: {'; '.join(outcome.wrong)}"
        print(told if outcome.wrong else f"ok     {fault.name}", file=sys.stderr, flush=True)
        return outcome

    start_server()
    possible = [fault for fault in faults if not fault.impossible]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        outcomes = list(pool.map(one, [fault for fault in possible if not fault.alone]))
    outcomes += [
        max((one(fault) for _ in range(rounds)), key=_badness) for fault in possible if fault.alone
    ]
    return sorted(outcomes, key=lambda outcome: possible.index(outcome.fault))


def _badness(outcome: Outcome) -> tuple[int, float]:
    return len(outcome.wrong), outcome.handover_ms or 0.0


def worst_handover(outcomes: Iterable[Outcome], *, starved: bool) -> tuple[float, str] | None:
    """The longest hand-over, ms, and its row, of rows that have a limit for it."""
    found = (
        (one.handover_ms, one.fault.name)
        for one in outcomes
        if one.handover_ms is not None
        and (one.fault.handover_ms or inf) < inf
        and (one.fault.group == "machine") == starved
    )
    return max(found, default=None)


def guard_cpu(domain: int, seconds: float = 10.0) -> float:
    """The guard's share of a CPU in PLAY, %."""
    shares = []

    def watch(session: Session) -> None:
        guard = session.guard()
        spent, begun = _cpu_of(guard), time.monotonic()
        time.sleep(seconds)
        shares.append(100.0 * (_cpu_of(guard) - spent) / (time.monotonic() - begun))

    fault = Fault(
        "none",
        "guard",
        act=watch,
        command=("stream", "demo", "--rate", "500"),
        code=0,
    )
    with tempfile.TemporaryDirectory() as folder:
        play(fault, domain, Path(folder))
    return shares[0]


def _cpu_of(pid: int) -> float:
    """CPU time of all threads of a process, s."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) / 1e9


def told(outcome: Outcome) -> str:
    """The reason that the program gives, up to a colon, without folders and brackets."""
    found = re.findall(r'"reason": "(.+)"', outcome.said) or re.findall(
        r"error: (.+)", outcome.said
    )
    text = json.loads(f'"{found[0]}"') if found else ""
    return re.sub(r"/tmp/\S+/| \([^()]*\)", "", text).partition(": ")[0].rstrip(".")


def table(outcomes: list[Outcome], *, markdown: bool = False) -> str:
    """The outcomes as text, or as a table in Markdown with a row before each group."""
    rows = [["fault", "exit, last command", "torque", "ms", "reason told"]]
    if markdown:
        rows.append(["---"] * len(rows[0]))
    group = ""
    for outcome in outcomes:
        if markdown and outcome.fault.group != group:
            group = outcome.fault.group
            rows.append([f"**{group}**", *[""] * (len(rows[0]) - 1)])
        figures = ["", ""]
        if outcome.commands:
            figures = [
                f"{outcome.worst_torque:.0%}",
                f"{outcome.handover_ms or outcome.silence_ms:.0f}",
            ]
        last = outcome.ending if outcome.commands else "none sent"
        rows.append([outcome.fault.name, f"{outcome.code}, {last}", *figures, told(outcome)])
    if markdown:
        return "\n".join(f"| {' | '.join(row)} |" for row in rows)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--match", default="", help="rows whose name contains this")
    parser.add_argument("--domain", type=int, default=80, help="the first of four DDS domains")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--markdown", action="store_true")
    args = parser.parse_args()
    chosen = [fault for fault in FAULTS if args.match in fault.name]
    outcomes = run(chosen, args.domain, args.rounds)
    found: dict[str, Any] = {
        "faults": len(outcomes),
        "failed": sum(bool(outcome.wrong) for outcome in outcomes),
        "skipped": sum(bool(fault.impossible) for fault in FAULTS),
        "worst_silence_ms": worst_handover(outcomes, starved=False),
        "worst_starved_ms": worst_handover(outcomes, starved=True),
        "guard_cpu_percent": guard_cpu(args.domain),
        "load": os.getloadavg()[0],
        "rows": {
            o.fault.name: {
                "group": o.fault.group,
                "exit_code": o.code,
                "commands": o.commands,
                "last_command": o.ending,
                "worst_step_rad": o.worst_step,
                "worst_dq_rad_s": o.worst_dq,
                "worst_torque": o.worst_torque,
                "silence_ms": o.silence_ms,
                "handover_ms": o.handover_ms,
                "file": o.file,
                "reason": told(o),
                "wrong": o.wrong,
            }
            for o in outcomes
        },
    }
    if args.json:
        print(json.dumps(found, indent=2))
        return
    if args.markdown:
        print(table(outcomes, markdown=True))
        return
    print(table(outcomes))
    for outcome in outcomes:
        for wrong in outcome.wrong:
            print(f"FAILED {outcome.fault.name}: {wrong}")
    figures = [f"{name} {value}" for name, value in found.items() if name not in ("rows", "load")]
    print(", ".join(figures), sides.load(), sep="\n")


if __name__ == "__main__":
    main()
