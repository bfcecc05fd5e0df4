"""Somebody else's tool makes a file whole whose recorder was killed."""

import importlib.util
import os
import subprocess
import sys

import pytest
from mcap.reader import make_reader

from g1stream.dds.topics import LOWCMD, LOWSTATE
from g1stream.session.session import open_session

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("pymcap_cli") is None, reason="pymcap-cli is not installed"
)

LOST_SOME = 3
"""How the tool ends when its input was cut."""


@pytest.mark.parametrize("share", [0.35, 0.8, 0.99])
def test_recover_saves_what_we_read(make_sample, write_session, tmp_path, share):
    topics = {"/lowcmd": LOWCMD, "/lowstate": LOWSTATE}
    sent = {t: [make_sample(topic).serialize() for _ in range(40)] for t, topic in topics.items()}
    path = write_session(*sent.items(), close=False)
    os.truncate(path, int(path.stat().st_size * share))
    killed, recovered = open_session(path), tmp_path / "recovered.mcap"
    program = "from sys import exit; from pymcap_cli.cli import main; exit(main())"
    command = [sys.executable, "-c", program, "recover", str(path), "-o", str(recovered)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode in {0, LOST_SOME}, done.stderr
    saved = open_session(recovered)
    assert saved.complete
    assert not killed.complete
    assert saved.topics == killed.topics
    for topic in killed.topics:
        assert list(saved.messages(topic)) == list(killed.messages(topic))
    with recovered.open("rb") as file:
        assert sum(1 for _ in make_reader(file).iter_messages()) == sum(killed.topics.values())
