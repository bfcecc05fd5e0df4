"""The recorder under load: what is lost, what it costs, what a kill costs.

    python benchmarks/recorder.py                     one minute at 1 kHz, beside a plain recorder
    python benchmarks/recorder.py --seconds 600       ten
    python benchmarks/recorder.py --seconds 1800 --rate 4000 --parts 12
                                                      the messages of two hours, in twelve parts
    python benchmarks/recorder.py --limit             the rate at which it begins to lose
    python benchmarks/recorder.py --kill 100          SIGKILL at random moments

LowCmd, LowState and Reference come at the same rate each, from a process with the priority of a
loop, while others that do nothing but count keep the CPUs busy. CPU time and memory are those of
the recorder and of the processes that it started. Latency is from the stamp that the three samples
of a tick share until one is received; "written" is how long the publisher took to write all three.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from recorder_check import check, cpu_seconds, kill_at_random, resident_mb

if TYPE_CHECKING:
    from collections.abc import Iterator

HERE = Path(__file__).parent
OURS = [sys.executable, "-m", "g1stream", "record"]
PLAIN = [sys.executable, str(HERE / "recorder_plain.py")]
#: The recorder has matched and warmed up by then, s after the load was started.
WARM = 3.0
BUSY = "while True: pass"


@contextmanager
def process(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A child that is gone afterwards, however this ends."""
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


def load_command(domain: int, rate: float, seconds: float) -> list[str]:
    options = [f"--domain={domain}", f"--rate={rate}", f"--seconds={seconds}"]
    return [sys.executable, str(HERE / "recorder_load.py"), *options]


def run(
    recorder: list[str],
    path: Path,
    domain: int,
    rate: float,
    seconds: float,
    busy: int,
    parts: int = 1,
) -> dict[str, Any]:
    """Record a load; CPU and memory of the recorder, what it says and what was sent.

    The memory is that after `WARM` and at the end of each of `parts` of the time.
    """
    with ExitStack() as stack:
        for _ in range(busy):
            stack.enter_context(process([sys.executable, "-c", BUSY]))
        recording = stack.enter_context(process([*recorder, str(path), f"--domain={domain}"]))
        load = stack.enter_context(process(load_command(domain, rate, seconds)))
        time.sleep(WARM)
        start, cpu = time.monotonic(), cpu_seconds(recording.pid)
        memory = [resident_mb(recording.pid)]
        for part in range(1, parts + 1):
            end = start + max(1.0, seconds - WARM) * part / parts
            time.sleep(max(0.0, end - time.monotonic()))
            memory.append(resident_mb(recording.pid))
        used = cpu_seconds(recording.pid) - cpu
        elapsed = time.monotonic() - start
        sent = json.loads(load.communicate(timeout=60)[0])
        recording.send_signal(signal.SIGINT)
        said = json.loads(recording.communicate(timeout=60)[0])
        return {
            "cpu_percent": 100.0 * used / elapsed,
            "memory_mb": memory,
            "sent": sent,
            "said": said,
            "exit_code": recording.returncode,
        }


def measure(
    domain: int, rate: float, seconds: float, busy: int, directory: Path, parts: int = 1
) -> dict[str, Any]:
    """Ours at a rate: lost, told, CPU, memory, exactness."""
    path = directory / f"ours-{rate:g}.mcap"
    done = run([*OURS, "--json"], path, domain, rate, seconds, busy, parts)
    found, memory = check(path, done["sent"], parts), done["memory_mb"]
    path.unlink()
    return {
        "rate_hz": rate,
        "sent_rate_hz": done["sent"]["rate_hz"],
        "seconds": seconds,
        "sent": 3 * done["sent"]["sent"],
        "lost": found.lost,
        "told_lost": sum(done["said"]["recorder"]["lost"].values()),
        "dropped_datagrams": done["said"]["recorder"]["dropped_datagrams"],
        "exact": found.exact,
        "exit_code": done["exit_code"],
        "cpu_percent": done["cpu_percent"],
        "memory_mb": memory[-1],
        "memory_grown_mb": memory[-1] - memory[0],
        "latency_us": found.latency_us,
        "parts": [
            {"memory_mb": held, **latency}
            for held, latency in zip(memory[1:], found.by_part, strict=True)
        ],
        "written_us": dict(zip(("p50", "p99", "p99.9"), done["sent"]["written_us"], strict=True)),
        "file_mb": found.size_mb,
    }


def measure_plain(
    domain: int, rate: float, seconds: float, busy: int, directory: Path
) -> dict[str, Any]:
    """The plain recorder at a rate."""
    path = directory / "plain.mcap"
    done = run(PLAIN, path, domain, rate, seconds, busy)
    sent, recorded = 3 * done["sent"]["sent"], done["said"]["recorded"]
    path.unlink()
    return {
        "sent_rate_hz": done["sent"]["rate_hz"],
        "cpu_percent": done["cpu_percent"],
        "sent": sent,
        "lost": sent - recorded,
    }


def per_sample(row: dict[str, Any]) -> float:
    """CPU for each sample that got into the file."""
    return float(row["cpu_percent"] / (1.0 - row["lost"] / row["sent"]))


def print_row(name: str, row: dict[str, Any]) -> None:
    latency = row.get("latency_us", {})
    print(
        f"{name:<10} {row.get('sent_rate_hz', 0):>8.0f} {row['sent']:>9} {row['lost']:>8} "
        f"{row.get('told_lost', '-'):>8} {row['cpu_percent']:>7.1f} "
        f"{row.get('memory_mb', 0):>7.1f} {row.get('memory_grown_mb', 0):>6.1f} "
        + " ".join(f"{latency.get(p, 0):>7.0f}" for p in ("p50", "p99", "p99.9"))
    )
    if written := row.get("written_us"):
        values = " ".join(f"{written[p]:>7.0f}" for p in ("p50", "p99", "p99.9"))
        print(f"{'  written':<67}{values}")
    parts = row.get("parts", [])
    for number, part in enumerate(parts if len(parts) > 1 else [], 1):
        values = " ".join(f"{part[p]:>7.0f}" for p in ("p50", "p99", "p99.9", "p100"))
        print(f"  part {number:<44} {part['memory_mb']:>7.1f} {'':>6} {values}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="Hz, of each topic")
    parser.add_argument("--domain", type=int, default=97)
    parser.add_argument("--busy", type=int, default=1, help="processes that keep the CPUs busy")
    parser.add_argument("--parts", type=int, default=1, help="rows of memory and latency in time")
    parser.add_argument("--limit", action="store_true", help="double the rate until it loses")
    parser.add_argument("--kill", type=int, default=0, metavar="N")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    domain, seconds, busy = arguments.domain, arguments.seconds, arguments.busy
    result: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        if arguments.kill:
            with process(load_command(domain, arguments.rate, 1e6)):
                result = kill_at_random(OURS, directory, domain, arguments.kill)
        else:
            rows = [measure(domain, arguments.rate, seconds, busy, directory, arguments.parts)]
            while arguments.limit and not rows[-1]["lost"] and rows[-1]["rate_hz"] < 16_000:
                rate = 2 * rows[-1]["rate_hz"]
                rows.append(measure(domain, rate, min(seconds, 10), busy, directory))
            plain = measure_plain(domain, arguments.rate, min(seconds, 20.0), busy, directory)
            result = {
                **rows[0],
                "cpu_ratio": per_sample(plain) / per_sample(rows[0]),
                "plain": plain,
                "rates": rows,
            }
    if arguments.json:
        print(json.dumps(result, indent=2))
    elif arguments.kill:
        print("\n".join(f"{key:<14} {value}" for key, value in result.items()))
    else:
        print(
            f"{'':<10} {'Hz each':>8} {'sent':>9} {'lost':>8} {'told':>8} {'CPU %':>7} "
            f"{'MB':>7} {'grown':>6} {'p50 us':>7} {'p99':>7} {'p99.9':>7}"
        )
        for row in result["rates"]:
            print_row("g1stream", row)
        print_row("plain", result["plain"])
        print(f"CPU for each sample kept: the plain one's is {result['cpu_ratio']:.1f} times ours")


if __name__ == "__main__":
    main()
