"""Our side of the benchmarks; does in a tick what sdk_side.py does in one.

our_side.py operations --domain N     CPU of one of each, us
our_side.py run --domain N --rate HZ --seconds S     a control loop: CPU
our_side.py floor --rate HZ --seconds S    deadlines alone: lateness and CPU
our_side.py sockets --rate HZ --seconds S  deadlines, a datagram out and one in: CPU
our_side.py robot --domain N --rate HZ     publishes LowState and reads LowCmd until stdin ends
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from typing import Any

import numpy as np

from g1stream.clock import SystemClock, Ticker
from g1stream.config import RealtimeConfig
from g1stream.control.report import Lateness
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, LOWSTATE, LowCmd, LowState
from g1stream.realtime import on_time

BURST = 16


class Side:
    """What a controller of ours does in a tick."""

    def __init__(self, participant: Participant) -> None:
        self.writer = RawWriter(participant, LOWCMD)
        self.reader = RawReader(participant, LOWSTATE)
        self.command = LowCmd()
        self.state = LowState()
        self.targets = [np.full(29, value) for value in (0.1, 0.2, 0.3, 40.0, 1.0)]
        self.states = 0

    def decode(self, data: bytes) -> None:
        """Take out what control needs."""
        self.states += 1
        self.state.load(data)
        self.q = self.state.q.copy()
        self.dq = self.state.dq.copy()
        self.quaternion = self.state.quaternion.copy()

    def fill(self) -> bytes:
        """Set every motor's five numbers; without the checksum, as on the other side."""
        command, (q, dq, tau, kp, kd) = self.command, self.targets
        command.mode_pr[()] = 0
        command.mode_machine[()] = 5
        command.motor_mode = 1
        command.q[:] = q
        command.dq[:] = dq
        command.tau[:] = tau
        command.kp[:] = kp
        command.kd[:] = kd
        return command.tobytes()


def operations(side: Side, participant: Participant, n: int, pause: float) -> dict[str, float]:
    """CPU of this thread for one of each, us, in bursts with a pause before each."""
    reader = RawReader(participant, LOWSTATE, depth=BURST)
    writer = RawWriter(participant, LOWSTATE)
    state = LowState().seal()
    burst = BURST if pause == 0 else 1
    spent: Counter[str] = Counter()
    clock = time.thread_time_ns
    time.sleep(1.0)  # discovery
    for _ in range(n // burst):
        for _ in range(burst):
            writer.write(state)
        time.sleep(pause)
        start = clock()
        for _ in range(burst):
            data = side.fill()
        filled = clock()
        for _ in range(burst):
            side.writer.write(data)
        written = clock()
        samples = [reader.take(1)[0] for _ in range(burst)]
        taken = clock()
        for sample in samples:
            side.decode(sample.data)
        decoded = clock()
        for _ in range(burst):
            side.command.seal()
        sealed = clock()
        spent["fill"] += filled - start
        spent["write"] += written - filled
        spent["take"] += taken - written
        spent["decode"] += decoded - taken
        spent["crc"] += sealed - decoded
    count = n // burst * burst
    return {name: total / count / 1000.0 for name, total in spent.items()}


def run(side: Side, rate: float, seconds: float) -> dict[str, Any]:
    """A control loop at a rate."""
    clock, period = SystemClock(), round(1e9 / rate)
    time.sleep(1.0)  # discovery
    side.states = 0
    cpu, wall = time.process_time(), clock.now()
    ticker = Ticker(clock, period, wall)
    commands = 0
    for _, deadline in ticker:
        side.writer.write(side.fill())
        commands += 1
        sample = side.reader.take_latest()
        if sample is not None:
            side.decode(sample.data)
        if deadline - wall >= seconds * 1e9:
            break
    elapsed = (clock.now() - wall) / 1e9
    return {
        "cpu_percent": 100 * (time.process_time() - cpu) / elapsed,
        "commands": commands,
        "states": side.states,
        "skipped": ticker.skipped,
    }


def sleep_only(rate: float, seconds: float) -> dict[str, Any]:
    """Deadlines alone, kept by the same thread with the same rights: what this machine can do."""
    clock, lateness = SystemClock(), Lateness()
    with on_time(RealtimeConfig().priority):
        start, cpu = clock.now(), time.process_time()
        ticker = Ticker(clock, round(1e9 / rate), start)
        for _, deadline in ticker:
            lateness.add(clock.now() - deadline)
            if deadline - start >= seconds * 1e9:
                break
        cpu = time.process_time() - cpu
        elapsed = (clock.now() - start) / 1e9
    return {
        "cpu_percent": 100 * cpu / elapsed,
        "commands": lateness.n,
        "skipped": ticker.skipped,
        "max_us": lateness.maximum_ns / 1000.0,
        "histogram_us": lateness.sparse(),
    }


def sockets_only(rate: float, seconds: float) -> dict[str, Any]:
    """What the system takes for waking up, sending one sample and receiving one, without DDS.

    The peer sends from a process of its own; both samples have the sizes that they have on the
    wire.
    """
    command, state = LowCmd().tobytes(), LowState().tobytes()
    ours, peer = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for end in (ours, peer):
        end.bind(("127.0.0.1", 0))
        end.setblocking(False)
    clock, period = SystemClock(), round(1e9 / rate)

    def loop(end: socket.socket, to: Any, data: bytes, length: float) -> float:
        start, cpu = clock.now(), time.process_time()
        for _, deadline in Ticker(clock, period, start):
            end.sendto(data, to)
            with suppress(BlockingIOError):
                end.recv(2048)
            if deadline - start >= length * 1e9:
                break
        return 100 * (time.process_time() - cpu) / ((clock.now() - start) / 1e9)

    peer_id = os.fork()
    if not peer_id:
        try:
            loop(peer, ours.getsockname(), state, seconds + 1.0)
        finally:
            os._exit(0)  # never on into what follows
    share = loop(ours, peer.getsockname(), command, seconds)
    os.waitpid(peer_id, 0)
    return {"cpu_percent": share}


def be_robot(participant: Participant, rate: float) -> None:
    """Publish LowState and read LowCmd, the same for both sides."""
    gone = threading.Event()

    def listen() -> None:
        sys.stdin.read()
        gone.set()

    threading.Thread(target=listen, daemon=True).start()
    writer, reader = RawWriter(participant, LOWSTATE), RawReader(participant, LOWCMD)
    state, clock = LowState(), SystemClock()
    for k, _ in Ticker(clock, round(1e9 / rate), clock.now()):
        state.tick[()] = k
        writer.write(state.seal())
        reader.take_latest()
        if gone.is_set():
            return


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("mode", choices=["operations", "run", "robot", "floor", "sockets"])
    parser.add_argument("--domain", type=int)
    parser.add_argument("--rate", type=float, default=500.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--pause", type=float, default=0.0)
    args = parser.parse_args()
    if args.domain is None and args.mode in ("operations", "run", "robot"):
        parser.error("--domain is needed")
    if args.mode in ("floor", "sockets"):
        alone = sleep_only if args.mode == "floor" else sockets_only
        print(json.dumps(alone(args.rate, args.seconds)), flush=True)
        return
    with Participant(args.domain, "lo") as participant:
        if args.mode == "robot":
            be_robot(participant, args.rate)
            return
        side = Side(participant)
        if args.mode == "operations":
            result: dict[str, Any] = operations(side, participant, args.count, args.pause)
        else:
            result = run(side, args.rate, args.seconds)
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
