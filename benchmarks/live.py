"""Lateness of LowCmd beside a live view and its clients, and without: what `--live` costs the loop.

    python benchmarks/live.py [--rounds 3] [--seconds 15] [--json]

Our bridge runs all the time on the same machine, and the sides take turns: `g1stream stream` alone,
with `--live` and no client, with a client that subscribes to every channel and reads, and with one
that subscribes and never reads. The clients run on this machine, too.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

import loop
import sides
from g1stream.types import STREAM_RATE

if TYPE_CHECKING:
    from collections.abc import Iterator

ALONE = "without"
#: What each side with a live view has as a client: what it does, if there is one.
CLIENTS = {"no client": None, "client reads": "read", "client never reads": "wait"}
COLUMNS = ("p50", "p99", "max")


def be_client(port: int, does: str) -> None:
    """Subscribe to every channel of a server that is about to start, and read until it ends.

    Prints how many messages came. One that waits never reads: it ends when it is terminated.
    """
    address, protocols = f"ws://127.0.0.1:{port}", [Subprotocol("foxglove.sdk.v1")]
    while True:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
            break
        time.sleep(0.1)
    with connect(address, subprotocols=protocols, compression=None, max_queue=1) as websocket:
        websocket.recv()
        channels = [channel["id"] for channel in json.loads(websocket.recv())["channels"]]
        wanted = [{"id": channel, "channelId": channel} for channel in channels]
        websocket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        if does == "wait":
            time.sleep(3600.0)
        count = 0
        with suppress(ConnectionClosed):
            while True:
                websocket.recv()
                count += 1
    print(count)


@contextmanager
def client(port: int, does: str | None) -> Iterator[list[int]]:
    """Run a client meanwhile; afterwards the list has how many messages it received."""
    received: list[int] = []
    if does is None:
        yield received
        return
    command = [sys.executable, __file__, f"--port={port}", f"--client={does}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield received
        if does == "read":
            out, _ = process.communicate(timeout=20)
            received.append(int(out))
    finally:
        process.kill()
        process.wait()


def measure(domain: int, port: int, rounds: int, seconds: float) -> dict[str, Any]:
    """Figures of each side, by its name."""
    runs: dict[str, list[dict[str, Any]]] = {}
    received = 0
    rate = round(STREAM_RATE)
    with sides.beside([*sides.G1STREAM, "sim", f"--domain={domain}"]):
        for _ in range(rounds):
            runs.setdefault(ALONE, []).append(loop.stream(domain, rate, seconds))
            for side, does in CLIENTS.items():
                with client(port, does) as counts:
                    run = loop.stream(domain, rate, seconds, "--live", f"--live-port={port}")
                runs.setdefault(side, []).append(run)
                received += sum(counts)
    found: dict[str, Any] = {side: loop.merged(of) for side, of in runs.items()}
    for figures in found.values():
        late, without = figures["lateness_us"], found[ALONE]["lateness_us"]
        figures["ratio"] = {column: late[column] / without[column] for column in COLUMNS}
    found["received_per_command"] = received / found["client reads"]["commands"]
    return found


def table(found: dict[str, Any]) -> str:
    """The figures as text."""
    columns = [*(f"{name} us" for name in COLUMNS), *(f"{name} ratio" for name in COLUMNS)]
    lines = [f"{'live view':<20}" + "".join(f"{c:>10}" for c in [*columns, "skipped", "commands"])]
    for side in (ALONE, *CLIENTS):
        figures = found[side]
        lines.append(
            f"{side:<20}"
            + "".join(f"{figures['lateness_us'][name]:10.0f}" for name in COLUMNS)
            + "".join(f"{figures['ratio'][name]:10.2f}" for name in COLUMNS)
            + f"{figures['skipped']:10d}{figures['commands']:10d}"
        )
        lines += [f"{'':10}ended early: {reason}" for reason in figures["ended_by"]]
    lines.append(f"the client that reads: {found['received_per_command']:.1f} messages per command")
    return "\n".join([*lines, sides.load()])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--domain", type=int, default=89)
    parser.add_argument("--port", type=int, default=8799)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--client", choices=("read", "wait"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.client:
        be_client(args.port, args.client)
        return
    found = measure(args.domain, args.port, args.rounds, args.seconds)
    print(json.dumps(found, indent=2) if args.json else table(found))


if __name__ == "__main__":
    main()
