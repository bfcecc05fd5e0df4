import os
import pty
import subprocess
import sys
import time
from contextlib import suppress
from math import inf
from types import SimpleNamespace

import numpy as np
import pytest

from g1stream.cli.progress import RecorderStatus, loop_status
from g1stream.control.command import Prepared
from g1stream.control.report import LoopReport
from g1stream.control.schedule import PhaseState
from g1stream.session.records import RecorderSummary
from g1stream.types import Phase

RUN = """
import logging, time
from g1stream.cli.progress import ProgressDisplay
from g1stream.events import ConsoleHandler, handled_by
with handled_by(ConsoleHandler()), ProgressDisplay(lambda: (0.37, "37 %")):
    time.sleep(1.0)
    logging.getLogger("g1stream.x").warning("overrun")
    logging.getLogger("g1stream.x").info("HOLD -> DAMP")
    time.sleep(0.2)
print("end")
"""
EVENTS = "warning: overrun\nHOLD -> DAMP\n"


def on_terminal(**environment):
    """What `RUN` writes to a terminal."""
    leader, follower = pty.openpty()
    variables = {**os.environ, "TERM": "xterm", **environment}
    with subprocess.Popen(
        [sys.executable, "-c", RUN], stdout=follower, stderr=follower, env=variables
    ):
        os.close(follower)
        shown = b""
        with suppress(OSError):  # raised once no process has the terminal open
            while True:
                shown += os.read(leader, 4096)
    os.close(leader)
    return shown.decode().replace("\r\n", "\n")


@pytest.mark.slow
def test_without_a_terminal_only_events_are_printed():
    done = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("end\n", EVENTS)
    run = RUN.replace('"37 %")', '"37 %"), in_pipe=0.4')
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=True)
    first, *others = done.stderr.splitlines()
    assert (first, {*others}) == ("37 %", {"37 %", *EVENTS.splitlines()})


@pytest.mark.slow
def test_on_a_terminal_events_appear_above_the_status_which_is_removed_at_the_end():
    shown = on_terminal()
    assert shown.index("37 %") < shown.index("warning: overrun\n") < shown.rindex("37 %")
    assert "HOLD -> DAMP\n" in shown
    # Nothing is left of the status: it is erased from the line on which the cursor stands.
    assert shown.endswith("\x1b[Jend\n")
    frame = shown[: shown.index("\x1b[2F")]
    assert frame.startswith("\x1b[J\n")
    assert frame.count("\n") == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("terminal", "status", "coloured"),
    [
        ({"TERM": "xterm-256color", "NO_COLOR": ""}, True, True),
        ({"TERM": "xterm-256color", "NO_COLOR": "1"}, True, False),
        ({"TERM": "dumb"}, False, False),
    ],
)
def test_status_and_colours_are_what_the_terminal_can_show(terminal, status, coloured):
    shown = on_terminal(COLORTERM="truecolor", **terminal)
    assert "HOLD -> DAMP\n" in shown
    assert ("37 %" in shown) == status
    assert ("\x1b[38;" in shown) == coloured


@pytest.mark.slow
def test_a_closed_terminal_ends_only_the_display():
    leader, follower = pty.openpty()
    code = f"import sys\n{RUN}".replace('print("end")', "sys.exit(7)")
    with subprocess.Popen([sys.executable, "-c", code], stderr=follower) as process:
        os.close(follower)
        os.read(leader, 1)
        os.close(leader)
        assert process.wait(30) == 7


@pytest.fixture
def played():
    """A loop 6 s into 24 s; the left leg is 0.04 rad behind, measured 3 ms before the target."""
    report = LoopReport(2_000_000, *[SimpleNamespace()] * 4)
    report.lateness.add(250_000)
    report.lateness.add(60_000)
    report.skipped = 1
    arrived = time.monotonic_ns() - 7_000_000
    q = np.full(29, 0.2, np.float32)
    q[:6] -= 0.04
    measured = SimpleNamespace(q=q, arrived=arrived)
    target = SimpleNamespace(q=np.full(29, 0.203), dq=np.ones(29))
    newest = Prepared(b"", b"", target, arrived + 3_000_000, measured)
    return SimpleNamespace(
        state=PhaseState(Phase.PLAY, 0), motion_time=6.0, report=report, newest=newest
    )


def test_the_status_of_a_loop(played):
    motion = SimpleNamespace(duration=24.0)
    for part, fraction in (((3.0, 9.0), 0.5), ((9.0, 12.0), 0.0), ((0.0, inf), 0.25)):
        played.part = part
        assert loop_status(played, motion)[0] == fraction
    played.part = 0.0, 24.0
    fraction, text = loop_status(played, motion)
    assert fraction == 0.25
    first, second, third = text.split("\n")
    assert first.split() == ["PLAY", "6.00", "of", "24.00", "s"]
    assert "late 0.06 ms, worst 0.25 ms, 1 tick skipped; state " in second
    assert int(second.split()[-3]) >= 7
    assert third == "error L leg 0.0400  R leg 0.0000  waist 0.0000  L arm 0.0000  R arm 0.0000 rad"
    assert max(map(len, (first, second, third))) <= 80


def test_the_status_of_a_recorder_has_the_rates_of_the_last_second(monkeypatch):
    now = 100.0
    monkeypatch.setattr("g1stream.cli.progress.time.monotonic", lambda: now)
    recorder = SimpleNamespace(report=RecorderSummary(), received={})
    status = RecorderStatus(recorder)
    assert status() == (None, "nothing received yet")
    recorder.report = RecorderSummary(first_ns=10**18, last_ns=10**18 + 2_000_000_000)
    for seconds, received, shown in (
        (2.0, {"/lowcmd": 1000, "/lowstate": 998}, "lowcmd 500  lowstate 499"),
        (0.5, {"/lowcmd": 1000, "/lowstate": 1248}, "lowcmd 500  lowstate 499"),
        (0.5, {"/lowcmd": 1000, "/lowstate": 1498}, "lowcmd 0  lowstate 500"),
    ):
        now += seconds
        recorder.received = received
        assert status()[1].split("\n") == ["recorded 2.0 s; samples per second:", shown]
