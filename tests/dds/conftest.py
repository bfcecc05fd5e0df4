import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest

from g1stream.dds.layout import Layout


@pytest.fixture(scope="session")
def random_payload():
    """Random bytes as long as a type's payload."""
    return lambda idl_type, seed: np.random.default_rng(seed).integers(
        0, 256, Layout.of(idl_type).size, dtype=np.uint8
    )


PEER = """
import sys
import time
from g1stream.dds.domain import Participant
from g1stream.dds.endpoints import RawReader, RawWriter
from g1stream.dds.messages import LOWCMD, TOPICS

with Participant(int(sys.argv[1]), "lo") as participant:
    writers = {topic.name: RawWriter(participant, topic) for topic in TOPICS}
    reader = RawReader(participant, LOWCMD, ignore_own=True)
    print("ready", flush=True)
    for line in sys.stdin:
        topic, stamp, data = line.split()
        while not writers[topic].matched:  # that a reader sees us is not yet that we see it
            time.sleep(0.001)
        writers[topic].write(bytes.fromhex(data), int(stamp))
"""


class Peer:
    """Another process of ours, with a writer of every topic and a reader of LowCmd."""

    def __init__(self, process):
        self._process = process
        self.pid = process.pid

    def write(self, topic, stamp, data):
        assert self._process.stdin
        self._process.stdin.write(f"{topic} {stamp} {data.hex()}\n")
        self._process.stdin.flush()


@pytest.fixture
def peer_on():
    """Starts a Peer on a domain, for the length of a `with`; it must end in good order."""

    @contextmanager
    def start(domain_id):
        with subprocess.Popen(
            [sys.executable, "-c", PEER, str(domain_id)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as process:
            try:
                assert process.stdout
                assert process.stdin
                assert process.stdout.readline() == "ready\n"
                yield Peer(process)
                process.stdin.close()
                assert process.wait(20) == 0
            finally:
                process.kill()

    return start
