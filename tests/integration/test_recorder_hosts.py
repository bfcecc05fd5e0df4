"""Recorder and robot on two hosts: two network namespaces, each with a host name of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from g1stream.app.session import open_session

AHEAD_S = 3
ROBOT = f"""
import sys, time
from g1stream.dds.domain import Participant
from g1stream.dds.messages import LowState
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE
with Participant(int(sys.argv[1]), sys.argv[2]) as participant:
    writer, state = RawWriter(participant, LOWSTATE, 100), LowState()
    while not writer.matched:
        time.sleep(0.01)
    time.sleep(0.2)
    for tick in range(1, 1001):
        state.tick[()] = tick
        writer.write(state.seal(), time.time_ns() + {AHEAD_S} * 10**9)
        time.sleep(0.002)
    time.sleep(0.5)
"""


def ip(*arguments):
    return subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)


@pytest.fixture
def two_hosts():
    """Runs commands on one of two hosts, `left` and `right`, joined by a wire called `wire`."""
    names = {side: f"g1t{os.getpid()}{side[0]}" for side in ("left", "right")}
    made = [ip("netns", "add", name) for name in names.values()]
    try:
        if any(done.returncode for done in made):
            pytest.skip(f"no network namespaces here: {made[0].stderr.strip()}")
        left, right = names.values()
        pair = ("link", "add", "wire", "netns", left, "type", "veth", "peer", "wire")
        wired = ip(*pair, "netns", right)
        if wired.returncode:
            pytest.skip(f"no virtual wire here: {wired.stderr.strip()}")
        for number, name in enumerate(names.values(), start=1):
            ip("-n", name, "address", "add", f"10.93.7.{number}/24", "dev", "wire")
            for link in ("wire", "lo"):
                ip("-n", name, "link", "set", link, "up")

        def command(side, *words):
            script = f'hostname {side}; exec "$@"'
            shell = ["unshare", "--uts", "sh", "-c", script, "sh", *map(str, words)]
            return ["ip", "netns", "exec", names[side], *shell]

        yield command
    finally:
        for name in names.values():
            ip("netns", "delete", name)


def test_the_offset_between_two_hosts_is_estimated_and_reported(two_hosts, domain_id, tmp_path):
    path = tmp_path / "session.mcap"
    wire = ["--domain", domain_id, "--interface", "wire"]
    record = two_hosts("left", sys.executable, "-m", "g1stream", "record", path, "--json", *wire)
    robot = two_hosts("right", sys.executable, "-c", ROBOT, domain_id, "wire")
    with subprocess.Popen(
        record, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as recorder:
        try:
            subprocess.run(robot, check=True, timeout=60)
            time.sleep(0.5)
            recorder.send_signal(signal.SIGINT)
            said, told = recorder.communicate(timeout=30)
        finally:
            recorder.kill()
    report = json.loads(said)["recorder"]
    assert report["lost"]["/lowstate"] == 0
    delay = report["delays"]["/lowstate"]
    assert delay["hosts"] == ["right"]
    assert delay["clock_offset_estimate_ns"] == pytest.approx(-AHEAD_S * 1e9, abs=2e7)
    assert "clocks differ" in told
    # Reported, and nothing more: the stamps are those of each host.
    session = open_session(path)
    assert session.metadata["host"] == "left"
    # From the first that came after the two had met to the last.
    ticks = session.measured.tick
    assert ticks.tolist() == list(range(ticks[0], 1001))
    assert len(ticks) > 500
    offset = session.measured.log_time - session.measured.publish_time
    assert abs(offset + AHEAD_S * 10**9).min() < 5e7
    assert (offset < 0).all()
