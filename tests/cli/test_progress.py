"""Progress and events on a terminal and elsewhere."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from contextlib import suppress
from types import SimpleNamespace

import pytest

from g1stream.cli.progress import ProgressDisplay, loop_progress
from g1stream.control.phases import PhaseState
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


def on_terminal(**environment: str) -> str:
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


def test_without_a_terminal_only_events_are_printed():
    done = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("end\n", EVENTS)


def test_on_a_terminal_events_appear_above_the_bar_which_is_removed_at_the_end():
    shown = on_terminal()
    assert shown.index("37 %") < shown.index("warning: overrun\n") < shown.rindex("37 %")
    assert "HOLD -> DAMP\n" in shown
    assert shown.endswith("end\n")
    assert "\x1b[2K" in shown[shown.rindex("37 %") :]  # clears the line
    assert "\x1b[?25h" in shown[shown.rindex("37 %") :]  # shows the cursor again


@pytest.mark.parametrize(("no_color", "coloured"), [("", True), ("1", False)])
def test_no_color_is_honoured(no_color, coloured):
    colour = "\x1b[38;" in on_terminal(
        NO_COLOR=no_color, COLORTERM="truecolor", TERM="xterm-256color"
    )
    assert colour is coloured


def test_a_dumb_terminal_gets_no_bar():
    shown = on_terminal(TERM="dumb")
    assert EVENTS in shown
    assert "37 %" not in shown


def test_a_closed_terminal_ends_only_the_display():
    leader, follower = pty.openpty()
    code = f"import sys\n{RUN}".replace('print("end")', "sys.exit(7)")
    with subprocess.Popen([sys.executable, "-c", code], stderr=follower) as process:
        os.close(follower)
        os.read(leader, 1)
        os.close(leader)
        assert process.wait(30) == 7


def test_progress_of_a_loop():
    lateness = SimpleNamespace(maximum_ns=250_000)
    loop = SimpleNamespace(
        state=PhaseState(Phase.PLAY, 0), motion_time=6.0, report=SimpleNamespace(lateness=lateness)
    )
    fraction, text = loop_progress(loop, SimpleNamespace(duration=24.0))
    assert fraction == 0.25
    for part in ("PLAY", "6.0 / 24.0 s", "0.25 ms"):
        assert part in text


def test_a_display_without_a_terminal_starts_no_thread():
    with ProgressDisplay(lambda: pytest.fail("drawn")):
        pass
