"""`g1stream record` and `stream --record` as a user runs them, and what can go wrong with them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from contextlib import contextmanager

import pytest
from mcap.reader import make_reader

from g1stream.app.session import open_session
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawWriter
from g1stream.dds.messages import LOWSTATE, LowState
from threads import in_thread


@contextmanager
def robot(domain_id, rate=500):
    """LowStates at a rate, from a thread; yields what has been sent so far.

    The first ones may be lost: a reader that this writer sees may not see the writer yet.
    """
    sent = []
    with Participant(domain_id, "lo") as participant:
        writer, state = RawWriter(participant, LOWSTATE, 100), LowState()

        def publish(stop):
            while not stop.is_set():
                if writer.matched:
                    state.tick[()] = len(sent)
                    sent.append(state.seal())
                    writer.write(sent[-1])
                time.sleep(1 / rate)

        with in_thread(publish):
            yield sent


def lowstates(path):
    with path.open("rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages(topics=["/lowstate"])
        return [message.data for _, _, message in found]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTSTP])
def test_signals_end_with_a_complete_file(domain_id, running, tmp_path, until, number):
    path = tmp_path / "s.mcap"
    with (
        robot(domain_id) as sent,
        running("record", "-o", path, "--domain", domain_id, "--json") as process,
    ):
        until(lambda: len(sent) > 300, "samples")
        process.send_signal(number)
        said, _ = process.communicate(timeout=20)
    assert process.returncode == 0
    recorded = lowstates(path)
    assert len(recorded) == json.loads(said)["recorder"]["counts"]["/lowstate"] >= 200
    first = sent.index(recorded[0])
    assert recorded == sent[first : first + len(recorded)]


def test_two_robots_at_once_are_a_problem(domain_id, running, tmp_path, until):
    path = tmp_path / "s.mcap"
    with (
        running("record", "-o", path, "--domain", domain_id, "--json") as process,
        robot(domain_id) as sent,
        running("sim", "--domain", domain_id) as simulator,
    ):
        until(lambda: len(sent) > 300, "samples")
        assert any("several publishers" in line for line in process.stderr)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=20)
    (names,) = json.loads(said)["recorder"]["publishers"].values()
    assert any(f"(pid {os.getpid()} on " in name for name in names)
    assert any(name.startswith(f"g1stream sim (pid {simulator.pid} ") for name in names)
    (problem,) = [p for p in open_session(path).summary().problems if "at the same time" in p]
    assert all(name in problem for name in names)


@pytest.fixture
def small_disk(tmp_path):
    """A directory that holds 3 MiB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "none", str(place)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no small file system can be mounted here: {done.stderr.strip()}")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_full_disk_ends_the_recording_but_not_the_stream(
    domain_id, running, small_disk, tmp_path
):
    path = small_disk / "s.mcap"
    patient = tmp_path / "patient.toml"  # with a simulator that shares a busy machine
    patient.write_text("[safety]\nstate_timeout = 1.0\n")
    play = ["stream", "demo", "--domain", domain_id, "--config", patient, "--json"]
    play += ["--ramp", 0.5, "--duration", 4]
    with running("sim", "--domain", domain_id), running(*play, "--record", path) as stream:
        said, told = stream.communicate(timeout=60)
    outcome = json.loads(said)
    assert outcome["stream"]["reason"] == ""
    assert "No space left on device" in outcome["recorder"]["stopped"]
    assert f"record: error: {outcome['recorder']['stopped']}" in told
    assert stream.returncode == 1
    session = open_session(path)
    assert session.complete
    assert session.log[-1].text == outcome["recorder"]["stopped"]
    assert 100 < len(session.command) < outcome["stream"]["commands"]
    assert session.metadata["stream"]["commands"] == outcome["stream"]["commands"]
