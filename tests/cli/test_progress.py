"""What is shown beside a loop, and that nothing of it is lost at its end."""

import logging
from types import SimpleNamespace

import pytest

from g1stream.cli.progress import Watch, showing_progress
from g1stream.control.phases import PhaseState
from g1stream.types import Phase


@pytest.fixture
def loop():
    return SimpleNamespace(state=PhaseState(Phase.PLAY, 0), motion_time=0.0)


@pytest.fixture
def motion():
    return SimpleNamespace(duration=1.0)


def test_all_events_are_printed_before_anything_else(loop, motion, capsys):
    with showing_progress() as watch:
        watch(loop, motion)
        logger = logging.getLogger("g1stream.control.loop")
        logger.info("HOLD -> DAMP")
        logger.warning("overrun")
    assert capsys.readouterr().err == "HOLD -> DAMP\nwarning: overrun\n"


def test_a_watch_of_a_loop_that_never_ran_can_be_finished(loop, motion, capsys):
    Watch(loop, motion).finish()
    assert capsys.readouterr().err == ""
