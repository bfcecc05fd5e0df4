"""Starts the processes that the benchmarks measure, and reads what they print."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

HERE = Path(__file__).resolve().parent
G1STREAM = [sys.executable, "-m", "g1stream"]
OURS = [sys.executable, str(HERE / "our_side.py")]


def sdk() -> list[str]:
    """The command of the SDK's side; its environment is made on first use."""
    tool = HERE.parent / "tools" / "make_sdk_env.py"
    made = subprocess.run([sys.executable, tool], capture_output=True, text=True, check=False)
    if made.returncode:
        sys.exit(f"the SDK cannot run here: {made.stdout.strip() or made.stderr}")
    return [made.stdout.strip(), str(HERE / "sdk_side.py")]


def clean_environment() -> dict[str, str]:
    """The user's environment without a DDS configuration of the user's."""
    return {k: v for k, v in os.environ.items() if k != "CYCLONEDDS_URI"}


def result_of(command: list[str]) -> Any:
    """Run a side to its end; the JSON on its last line, after what the SDK may have to say."""
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=clean_environment()
    )
    if done.returncode:
        sys.exit(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


@contextmanager
def beside(command: list[str]) -> Iterator[None]:
    """A process that runs meanwhile and ends when its standard input does, or when terminated."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=clean_environment(),
    )
    try:
        time.sleep(3.0)
        if process.poll() is not None:
            sys.exit(f"{' '.join(command)} ended with {process.returncode}")
        yield
    finally:
        process.terminate()
        process.wait(20)


def percentile(histogram: Mapping[int, int], percent: float) -> float:
    """The value that `percent` of what a histogram counts does not exceed: a bin's upper edge."""
    rank = sum(histogram.values()) * percent / 100.0
    seen = 0
    for value in sorted(histogram):
        seen += histogram[value]
        if seen >= rank:
            return value + 1.0
    return float("nan")


def load() -> str:
    """The load of this machine over the last minute, as a line for under a table."""
    return f"{os.cpu_count()} CPUs, load average {os.getloadavg()[0]:.1f} at the end of the run"
