"""From exec to the first LowCmd on the wire, our bridge already running; and to the end of --help.

python benchmarks/start.py [--rounds 10] [--json]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from statistics import median

import sides
from g1stream.dds.discovery import OBSERVER
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader
from g1stream.dds.messages import LOWCMD


def first_command(domain: int) -> float:
    """Seconds from exec to the publish time of the first LowCmd."""
    with Participant(domain, "lo") as participant:
        reader = RawReader(participant, LOWCMD, depth=10_000, user_data=OBSERVER)
        started = time.time_ns()
        process = subprocess.Popen(
            [*sides.G1STREAM, "stream", "demo", f"--domain={domain}", "--ramp=0.2"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=sides.clean_environment(),
        )
        samples = reader.take(1)
        while not samples and process.poll() is None:
            time.sleep(0.01)
            samples = reader.take(1)
        process.terminate()
        process.wait()
    if not samples:
        sys.exit(f"g1stream stream ended with exit code {process.returncode} before a command")
    return (samples[0].publish_time - started) / 1e9


def help_shown() -> float:
    """Seconds that `g1stream --help` takes."""
    start = time.monotonic()
    subprocess.run([*sides.G1STREAM, "--help"], stdout=subprocess.DEVNULL, check=True)
    return time.monotonic() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--domain", type=int, default=86)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    helps = [help_shown() for _ in range(args.rounds)]
    with sides.beside([*sides.G1STREAM, "sim", f"--domain={args.domain}"]):
        commands = [first_command(args.domain) for _ in range(args.rounds)]
    if args.json:
        print(json.dumps({"help_s": median(helps), "first_command_s": median(commands)}))
        return
    for name, times in (("g1stream --help", helps), ("exec to the first LowCmd", commands)):
        print(f"{name:<26} median {median(times):.2f} s, {min(times):.2f} to {max(times):.2f}")
    print(sides.load())


if __name__ == "__main__":
    main()
