"""Unitree's official SDKs as processes that tests talk with; see sdk_peers/."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ROOT = Path(__file__).resolve().parents[2]
PEERS = Path(__file__).parent / "sdk_peers"
IMPOSSIBLE = 3

#: Longer than anything takes on a busy machine, shorter than pytest's own limit.
PATIENCE = 30.0


@pytest.fixture(scope="session")
def sdk_python() -> Path:
    """The interpreter of the environment with the official SDKs, made on first use."""
    tool = ROOT / "tools" / "make_sdk_env.py"
    made = subprocess.run([sys.executable, tool], capture_output=True, text=True, check=False)
    if made.returncode == IMPOSSIBLE:
        pytest.skip(f"the official SDKs cannot run here: {made.stdout.strip()}")
    assert made.returncode == 0, made.stderr
    return Path(made.stdout.strip())


class Peer:
    """A running process of an SDK.

    Args:
        python: its interpreter.
        log: the file for what it prints.
        args: script below sdk_peers/ and its arguments.
    """

    def __init__(self, python: Path, log: Path, *args: str) -> None:
        self.name = " ".join(args)
        self._log = log
        environment = {k: v for k, v in os.environ.items() if k != "CYCLONEDDS_URI"}
        with log.open("w") as errors:
            self.process = subprocess.Popen(
                [python, "-X", "faulthandler", PEERS / args[0], *args[1:]],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=environment,
            )
        self._reports: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._listener = threading.Thread(target=self._listen)
        self._listener.start()

    def _listen(self) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            self._reports.put(json.loads(line))
        self._reports.put(None)

    def tell(self, instruction: Any) -> None:
        """Send it one value."""
        assert self.process.stdin
        self.process.stdin.write(json.dumps(instruction) + "\n")
        self.process.stdin.flush()

    def next_report(self, within: float = PATIENCE) -> dict[str, Any] | None:
        """Its next report, or None when there is none in time."""
        try:
            report = self._reports.get(timeout=within)
        except queue.Empty:
            return None
        assert report is not None, f"{self.name} is gone\n{self.ended()}"
        return report

    def wait_ready(self) -> None:
        """Return when it says that it has joined its domain."""
        report = self.next_report()
        assert report, f"{self.name} does not become ready\n{self.errors()}"
        assert report["event"] == "ready"

    def errors(self) -> str:
        """What it and its SDK have printed so far."""
        return self._log.read_text()

    def ended(self) -> str:
        """How it ended and what it printed."""
        code = self.process.wait(PATIENCE)
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"{how}\n{self.errors()}"

    def stop(self) -> None:
        """Tell it that the test is done; it must then leave in order."""
        assert self.process.stdin
        assert self.process.poll() is None, f"{self.name} died: {self.ended()}"
        self.process.stdin.close()
        how = self.ended()
        assert self.process.returncode == 0, f"{self.name} ended with {how}"

    def clean_up(self) -> None:
        """Leave nothing of it behind, whatever happened."""
        self.process.kill()
        self.process.wait()
        self._listener.join()
        for file in (self.process.stdin, self.process.stdout):
            if file:
                file.close()


@pytest.fixture
def start_peer(sdk_python: Path, tmp_path: Path) -> Iterator[Callable[..., Peer]]:
    """Start a script of sdk_peers/; at the end of a test all must be alive, and leave well."""
    peers: list[Peer] = []

    def start(*args: str) -> Peer:
        peers.append(Peer(sdk_python, tmp_path / f"peer-{len(peers)}.log", *args))
        return peers[-1]

    try:
        yield start
        for peer in peers:
            peer.stop()
    finally:
        for peer in peers:
            peer.clean_up()
