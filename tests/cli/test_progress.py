"""What is shown beside a loop, and that nothing of it is lost at its end."""

from collections import deque
from types import SimpleNamespace

import pytest

from g1stream.cli.progress import Watch
from g1stream.control.phases import PhaseState
from g1stream.types import Phase


@pytest.fixture
def loop():
    return SimpleNamespace(state=PhaseState(Phase.PLAY, 0), events=deque(), motion_time=0.0)


@pytest.fixture
def motion():
    return SimpleNamespace(duration=1.0)


def test_the_last_events_are_shown_before_what_is_printed_next(loop, motion, capsys):
    watching = Watch(loop, motion)
    loop.state = PhaseState(Phase.DONE, 0)
    loop.events.extend([(2, "HOLD -> DAMP"), (2, "DAMP -> DONE")])
    watching.finish()
    assert capsys.readouterr().err == "HOLD -> DAMP\nDAMP -> DONE\n"


def test_a_watch_of_a_loop_that_never_ran_can_be_finished(loop, motion, capsys):
    watching = Watch(loop, motion)
    watching.finish()
    loop.events.append((2, "too late"))
    assert capsys.readouterr().err == ""
