"""The same motion on Unitree's own simulators: scripts on Unitree's SDK, and g1stream.

Run by `python benchmarks/tracking.py --peers`; feet_peers.py uses the same simulators. They must be
set up in the folder that the environment variable PEERS gives, by default `peers` in the temporary
directory. It has

    ns CMD...                     runs a command in the network of the simulators, domain 1 on lo
    start_cppsim.sh, start_pysim.sh    start a simulator; its process id is in cppsim.pid, pysim.pid
    sdkplay.py RATE SECONDS OUT   plays the CSV file $MOTION with the SDK in sdk/: position only,
                                  the nearest frame; prints its RMSE
    keys py|cpp KEY               presses a key in a simulator's window (feet_peers.py)

Every run has a simulator of its own, because one that was blown up stays so. Runs of several users
of the folder follow each other: each holds a lock beside it.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

import numpy as np

from g1stream.app.session import open_session
from g1stream.errors import G1StreamError

PEERS: Final = Path(os.environ.get("PEERS") or Path(tempfile.gettempdir(), "peers"))
SIMULATORS: Final = {"C++": "cppsim", "Python": "pysim"}
SCRIPTS: Final = {"30 Hz script on the SDK": 30, "500 Hz script on the SDK": 500}
STREAMS: Final = {
    "none": ["--feedforward", "none"],
    "velocity": ["--feedforward", "velocity"],
    "dynamics, hanging": ["--feedforward", "dynamics", "--support", "hanging"],
}
#: Until a simulator publishes and its robot hangs still, s.
_SETTLE: Final = 5.0
#: What a run takes beside the motion at most, s.
_MARGIN: Final = 60.0


class Run(NamedTuple):
    """RMSE over all joints and time, rad; None where the run failed or gave no number, and why."""

    rmse: float | None
    failure: str = ""


def missing(*others: str) -> str:
    """Why the simulators, and other files of the folder, cannot be used, or ""."""
    files = ["ns", *(f"start_{one}.sh" for one in SIMULATORS.values()), *others]
    absent = [name for name in files if not (PEERS / name).exists()]
    if absent:
        return f"{PEERS} has no {', '.join(absent)}; set PEERS to the folder of the simulators"
    return ""


def run_table(
    motion: Path,
    seconds: float,
    runs: int,
    flags: list[str],
    *,
    rows: str = "",
    keep: Path | None = None,
) -> dict[str, dict[str, list[Run]]]:
    """Every run: by way to command and simulator.

    Args:
        motion: CSV file.
        seconds: how much of it to play.
        runs: how often.
        flags: more flags of `g1stream stream`.
        rows: only the ways to command with this text in their names.
        keep: a folder for the sessions; None: deleted.
    """
    table: dict[str, dict[str, list[Run]]] = {}
    for number in range(runs):
        for simulator, program in SIMULATORS.items():
            for row in (name for name in (*SCRIPTS, *STREAMS) if rows in name):
                name = f"{program}-{row.split(',')[0]}-{number}.mcap"
                with tempfile.TemporaryDirectory() as directory, running(program):
                    path = Path(keep or directory, name)
                    if row in SCRIPTS:
                        run = _script(motion, seconds, SCRIPTS[row])
                    else:
                        run = stream_on_peer(motion, seconds, [*STREAMS[row], *flags], path)
                table.setdefault(row, {}).setdefault(simulator, []).append(run)
                print(f"{simulator}, {row}: {_shown(run)}", flush=True, file=sys.stderr)
    return table


def as_text(table: dict[str, dict[str, list[Run]]]) -> str:
    """The median, and every run, rad."""
    lines = []
    for row, columns in table.items():
        for simulator, runs in columns.items():
            valid = [run.rmse for run in runs if run.rmse is not None]
            middle = f"{median(valid):.4f}" if valid else "-"
            every = ", ".join(map(_shown, runs))
            lines.append(f"{row:26}{simulator:8}{middle:>8}   {every}")
    return "\n".join(lines)


def as_json(table: dict[str, dict[str, list[Run]]]) -> dict[str, Any]:
    """The same for machines."""
    return {
        row: {simulator: [run._asdict() for run in runs] for simulator, runs in columns.items()}
        for row, columns in table.items()
    }


def _shown(run: Run) -> str:
    return run.failure if run.rmse is None else f"{run.rmse:.4f}"


@contextmanager
def running(program: str, *arguments: str) -> Iterator[None]:
    """A simulator of its own, while nobody else uses the folder; arguments go to it."""
    with Path(f"{PEERS}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        # The lock is not inherited: descriptors of Python are closed in child processes.
        subprocess.run([PEERS / f"start_{program}.sh", *arguments], check=True, stdout=sys.stderr)
        pid = int((PEERS / f"{program}.pid").read_text())
        try:
            time.sleep(_SETTLE)
            yield
        finally:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGTERM)
                time.sleep(1.0)
                os.kill(pid, signal.SIGKILL)


def _run(command: Sequence[str | Path], seconds: float, **variables: str) -> tuple[str, str]:
    """What a command in the simulators' network prints on standard output, and why it failed."""
    try:
        done = subprocess.run(
            [PEERS / "ns", *command],
            env={**os.environ, **variables},
            capture_output=True,
            text=True,
            timeout=seconds + _MARGIN,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", "did not end"
    lines = done.stderr.strip().splitlines() or [""]
    return done.stdout, f"exit code {done.returncode}: {lines[-1]}" if done.returncode else ""


def _script(motion: Path, seconds: float, rate: int) -> Run:
    with tempfile.TemporaryDirectory() as directory:
        output = Path(directory, "run.npz")
        script = PEERS / "sdkplay.py"
        command: list[str | Path] = [
            PEERS / "sdk/bin/python",
            script,
            str(rate),
            str(seconds),
            output,
        ]
        text, failure = _run(command, seconds, MOTION=str(motion))
    found = re.search(r"RMSE (\S+) rad", text)
    if failure or not found:
        return Run(None, failure or "printed no RMSE")
    rmse = float(found[1])
    return Run(rmse) if np.isfinite(rmse) else Run(None, "NaN: the simulation exploded")


def stream_on_peer(motion: Path, seconds: float, flags: list[str], path: Path) -> Run:
    command = [sys.executable, "-m", "g1stream", "stream", str(motion), "--json"]
    text, failure = _run([*command, "--duration", str(seconds), "--record", path, *flags], seconds)
    if failure:
        with suppress(ValueError, KeyError):  # it says better what ended it
            failure = json.loads(text)["termination"]["reason"] or failure
        return Run(None, failure)
    try:
        return Run(open_session(path).tracking().overall)
    except G1StreamError as error:
        return Run(None, error.cause)
