"""From the kernel's time of a datagram to the log_time of the sample in it.

    python benchmarks/kernel_time.py [--seconds 20] [--busy 0] [--json]      as root

What a log_time would gain by the kernel's own receive times: a packet socket on `lo` notes them
(SO_TIMESTAMPNS) for each datagram of RTPS, whose timestamp and size tell which sample is in it.
"""

from __future__ import annotations

import argparse
import json
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from g1stream.dds.messages import LowCmd, LowState
from g1stream.realtime import on_time
from recorder import BUSY, OURS, load_command, process

#: By the size of a sample with its header, the topic.
SIZES = {len(LowCmd().tobytes()): "/lowcmd", len(LowState().tobytes()): "/lowstate"}
#: Of RTPS 2.3, chapter 9.4: the submessages, and the length of a message's header.
INFO_TS, DATA, HEADER = 0x09, 0x15, 20
#: Before the payload in a DATA submessage without inline QoS.
BEFORE_PAYLOAD = 20
SO_TIMESTAMPNS = 35
ETHERNET, IP, UDP = 14, 20, 8


def samples_in(message: bytes) -> list[tuple[str, int]]:
    """Topic and source timestamp, ns, of the samples in a message of RTPS."""
    found, at, stamp = [], HEADER, 0
    while message[:4] == b"RTPS" and at + 4 <= len(message):
        kind, flags, length = struct.unpack_from("<BBH", message, at)
        if kind == INFO_TS and not flags & 2:
            seconds, fraction = struct.unpack_from("<II", message, at + 4)
            stamp = seconds * 10**9 + round(fraction * 1e9 / 2**32)
        if kind == DATA and (topic := SIZES.get(length - BEFORE_PAYLOAD)):
            found.append((topic, stamp))
        if not length:
            break
        at += 4 + length
    return found


class Capture(threading.Thread):
    """Notes when the kernel received each sample, by topic and source timestamp in us."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.times: dict[tuple[str, int], int] = {}
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
        self._socket.bind(("lo", 0))
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**26)
        self._socket.settimeout(0.2)
        self.stopped = threading.Event()

    def run(self) -> None:
        while not self.stopped.is_set():
            try:
                frame, extra, _, address = self._socket.recvmsg(65536, 256)
            except TimeoutError:
                continue
            if address[2] == socket.PACKET_OUTGOING:  # loopback shows each twice
                continue
            seconds, ns = struct.unpack("qq", extra[0][2])
            for topic, stamp in samples_in(frame[ETHERNET + IP + UDP :]):
                self.times.setdefault((topic, round(stamp / 1000)), seconds * 10**9 + ns)


def measure(seconds: float, busy: int, domain: int) -> dict[str, float]:
    """Percentiles of log_time less the kernel's time, us, and how many samples were matched."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        path = Path(name) / "session.mcap"
        for _ in range(busy):
            stack.enter_context(process([sys.executable, "-c", BUSY]))
        recording = stack.enter_context(process([*OURS, str(path), f"--domain={domain}"]))
        capture = Capture()
        with on_time(0):
            capture.start()
            subprocess.run(load_command(domain, 500.0, seconds), check=True, capture_output=True)
        capture.stopped.set()
        capture.join()
        recording.send_signal(signal.SIGINT)
        recording.wait()
        gained, n = [], 0
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages(topics=list(SIZES.values())):
                n += 1
                received = capture.times.get((channel.topic, round(message.publish_time / 1000)))
                if received is not None:
                    gained.append(message.log_time - received)
    values = np.percentile(gained, (50, 99, 99.9)) / 1e3
    return {
        "samples": n,
        "matched": len(gained),
        **dict(zip(("p50_us", "p99_us", "p99.9_us"), values.tolist(), strict=True)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--busy", type=int, default=0, help="processes that keep the CPUs busy")
    parser.add_argument("--domain", type=int, default=97)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found = measure(arguments.seconds, arguments.busy, arguments.domain)
    if arguments.json:
        print(json.dumps(found, indent=2))
        return
    print("\n".join(f"{name:<10} {value:10.0f}" for name, value in found.items()))


if __name__ == "__main__":
    main()
