"""Reading a long session: ours beside the stock MCAP reader, in one run.

    python benchmarks/session.py SESSION [--minutes N] [--json]

SESSION is a recording, such as demo-out/session.mcap. Its messages are repeated, with later times,
until they last for N minutes; that file is then opened, read and read again as a killed recorder
would have left it. Each reading runs in a process of its own. The stock side takes the messages of
/lowstate with `mcap.reader` and looks up the same joint angles in their bytes, so that what differs
is the reading.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

TOPIC = "/lowstate"


def lengthen(source: Path, target: Path, minutes: float) -> None:
    """Write a session of so many minutes by repeating the messages of another."""
    from g1stream.app.session import open_session
    from g1stream.session.writer import SessionWriter

    session = open_session(source)
    times = session.times
    first = min(int(stream.log_time.min()) for stream in times.values())
    last = max(int(stream.log_time.max()) for stream in times.values())
    messages = {topic: list(session.messages(topic)) for topic in times}
    span, end = last - first + 2_000_000, first + round(minutes * 60e9)
    step = 50_000_000
    with SessionWriter(target, force=True) as writer:
        writer.add_metadata(session.metadata)
        for start in range(first, end, span):
            for begin in range(0, min(span, end - start), step):
                for topic, recorded in messages.items():
                    logged = times[topic].log_time
                    here = slice(*np.searchsorted(logged, [first + begin, first + begin + step]))
                    shift = start - first
                    writer.write_batch(
                        topic,
                        [message.data for message in recorded[here]],
                        logged[here] + shift,
                        times[topic].publish_time[here] + shift,
                    )


def ours(path: Path) -> dict[str, float]:
    """Open a session and take the joint angles as an array."""
    from g1stream.app.session import open_session

    begun = time.perf_counter()
    session = open_session(path)
    opened = time.perf_counter()
    q = session.measured.read("q").q
    return _result(begun, opened, q)


def stock(path: Path) -> dict[str, float]:
    """The same with the stock reader."""
    from mcap.reader import make_reader

    from g1stream.dds.layout import Layout
    from g1stream.dds.messages import LOWSTATE

    field = Layout.of(LOWSTATE.message.idl_type)["motor_state.q"]
    begun = time.perf_counter()
    with path.open("rb") as file:
        reader = make_reader(file)
        reader.get_summary()
        opened = time.perf_counter()
        taken = [message.data for _, _, message in reader.iter_messages(topics=[TOPIC])]
    rows = np.frombuffer(b"".join(taken), np.uint8).reshape(len(taken), -1)
    return _result(begun, opened, field.read(rows[:, 4:])[:, :29].astype(np.float64))


def _result(begun: float, opened: float, q: Any) -> dict[str, float]:
    return {
        "open_s": opened - begun,
        "array_s": time.perf_counter() - opened,
        "cpu_s": time.process_time(),
        "samples": len(q),
        "checksum": float(np.abs(q).sum()),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def measured(side: str, path: Path) -> dict[str, float]:
    """What a side says, run in a process of its own."""
    command = [sys.executable, __file__, str(path), "--side", side]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


def run(source: Path, minutes: float) -> dict[str, Any]:
    """Everything, on a temporary file."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "long.mcap"
        lengthen(source, path, minutes)
        size = path.stat().st_size
        figures: dict[str, Any] = {
            "minutes": minutes,
            "size_mb": size / 1e6,
            "ours": measured("ours", path),
            "stock": measured("stock", path),
        }
        os.truncate(path, size * 9 // 10)
        figures["ours_killed"] = measured("ours", path)
    for key in ("samples", "checksum"):
        if figures["ours"][key] != figures["stock"][key]:
            raise SystemExit(f"the two sides read a different {key}: {figures}")
    figures["array_ratio"] = figures["stock"]["array_s"] / figures["ours"]["array_s"]
    return figures


def table(figures: dict[str, Any]) -> str:
    """The figures for people."""
    lines = [
        f"{figures['minutes']:g} minutes, {figures['size_mb']:.0f} MB; joint angles of {TOPIC}",
        f"{'':<28}{'open s':>8}{'array s':>9}{'CPU s':>8}{'peak MB':>9}{'samples':>9}",
    ]
    for side, name in (
        ("ours", "g1stream"),
        ("ours_killed", "g1stream, recorder killed"),
        ("stock", "mcap reader"),
    ):
        one = figures[side]
        lines.append(
            f"{name:<28}{one['open_s']:8.2f}{one['array_s']:9.2f}{one['cpu_s']:8.2f}"
            f"{one['peak_mb']:9.0f}{one['samples']:9.0f}"
        )
    return "\n".join([*lines, f"the stock reader takes {figures['array_ratio']:.1f} times as long"])


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("session", type=Path)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--side", choices=["ours", "stock"], help=argparse.SUPPRESS)
    flags = parser.parse_args()
    if flags.side:
        print(json.dumps({"ours": ours, "stock": stock}[flags.side](flags.session)))
        return
    figures = run(flags.session, flags.minutes)
    print(json.dumps(figures, indent=2) if flags.json else table(figures))


if __name__ == "__main__":
    main()
