import os
from pathlib import Path
from typing import NamedTuple

import pytest

from g1stream.cli.main import main


@pytest.fixture
def matches_snapshot():
    """Compare a text with the file of a name; UPDATE_SNAPSHOTS=1 writes that anew."""

    def check(name, text):
        path = Path(__file__).with_name("snapshots") / f"{name}.txt"
        if os.environ.get("UPDATE_SNAPSHOTS"):
            path.write_text(f"{text}\n")
        assert f"{text}\n" == path.read_text()

    return check


class Ended(NamedTuple):
    """A command that has ended: its exit code, and what it printed."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys):
    """Run a command in this process."""

    def run_command(*arguments):
        capsys.readouterr()
        code = main([*map(str, arguments)])
        return Ended(code, *capsys.readouterr())

    return run_command
