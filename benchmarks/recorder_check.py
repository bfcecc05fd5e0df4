"""What the recorder's benchmark looks at: recordings, with the stock reader, and processes."""

from __future__ import annotations

import hashlib
import os
import random
import signal
import struct
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from g1stream.app.session import open_session
from g1stream.errors import RecordingError

TICKS = os.sysconf("SC_CLK_TCK")


@dataclass
class Found:
    """What the stock reader found in a recording."""

    lost: int
    exact: bool
    latency_us: dict[str, float]
    by_part: list[dict[str, float]]
    size_mb: float


def check(path: Path, sent: dict[str, Any], parts: int) -> Found:
    """Compare a recording, byte for byte, with what was sent; latencies of it and of its parts."""
    lost, exact, first = 0, True, 0
    length = 1e9 * sent["sent"] / sent["rate_hz"]
    delays: list[list[int]] = [[] for _ in range(parts)]
    for topic, digest in sent["sha256"].items():
        found, count = hashlib.sha256(), 0
        with path.open("rb") as file:
            for _, _, message in make_reader(file).iter_messages(topics=[topic]):
                found.update(message.data)
                first = first or message.publish_time
                part = int(parts * (message.publish_time - first) / length)
                delays[min(max(part, 0), parts - 1)].append(message.log_time - message.publish_time)
                count += 1
        lost += sent["sent"] - count
        exact &= found.hexdigest() == digest
    by_part = [_latency(part) for part in delays]
    whole = _latency([delay for part in delays for delay in part])
    return Found(lost, exact, whole, by_part, path.stat().st_size / 1e6)


def _latency(delays: list[int]) -> dict[str, float]:
    """Percentiles, us."""
    percentiles = (50, 99, 99.9, 100)
    found = delays or [0]  # a part in which everything was lost
    values = np.percentile(found, percentiles) / 1e3
    return {f"p{p:g}": float(v) for p, v in zip(percentiles, values, strict=True)}


def processes(pid: int) -> list[int]:
    """A process and those that it started."""
    started = [
        int(child)
        for task in Path(f"/proc/{pid}/task").glob("*/children")
        for child in task.read_text().split()
    ]
    return [pid, *(one for child in started for one in processes(child))]


def cpu_seconds(pid: int) -> float:
    """User and system time so far of a process and those that it started."""
    used = 0
    for one in processes(pid):
        fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
        used += int(fields[11]) + int(fields[12])
    return used / TICKS


def resident_mb(pid: int) -> float:
    """Memory that a process and those that it started hold, shared pages once for each."""
    held = 0
    for one in processes(pid):
        for line in Path(f"/proc/{one}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                held += int(line.split()[1])
    return held / 1024


def kill_at_random(recorder: list[str], directory: Path, domain: int, times: int) -> dict[str, Any]:
    """Kill a recorder at random moments, and look at what is left."""
    chance = random.Random(2)
    losses, unreadable = [], 0
    for number in range(times):
        path = directory / f"killed-{number}.mcap"
        command = [*recorder, str(path), f"--domain={domain}"]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as child:
            try:
                _wait_for_samples(path)
                time.sleep(chance.uniform(0.0, 2.0))
            finally:
                killed = time.time_ns()
                child.send_signal(signal.SIGKILL)
        last = _last_log_time(path)
        unreadable += last is None or not _opens(path)
        if last is not None:
            losses.append((killed - last) / 1e9)
        path.unlink()
    return {
        "kills": times,
        "unreadable": unreadable,
        "worst_loss_s": max(losses, default=None),
        "median_loss_s": float(np.median(losses)) if losses else None,
    }


def _wait_for_samples(path: Path, within: float = 20.0) -> None:
    """Until the file holds a first chunk of samples."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        if path.exists() and (_last_log_time(path) or 0):
            return
        time.sleep(0.02)


def _last_log_time(path: Path) -> int | None:
    """The newest log time of the samples, by the stock reader up to the last whole chunk."""
    last = None
    with path.open("rb") as file, suppress(EndOfFile, struct.error):
        channels: dict[int, str] = {}
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message) and channels[record.channel_id] == "/lowstate":
                last = max(last or 0, record.log_time)
    return last


def _opens(path: Path) -> bool:
    try:
        return len(open_session(path).measured.q) > 0
    except RecordingError:
        return False
