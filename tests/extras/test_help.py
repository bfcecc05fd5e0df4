import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from cli_help import check_help
from g1stream.cli.main import COMMANDS, load_command

CORE_ALONE = Path(__file__).parents[1] / "core_alone"
OF_EXTRAS = {name: row for name, row in COMMANDS.items() if row.home.startswith("extras.")}


@pytest.mark.parametrize("command", OF_EXTRAS)
def test_help_has_examples_and_exit_codes_within_80_columns(command, monkeypatch, capsys):
    check_help(command, monkeypatch, capsys)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_quiet(command):
    (quiet,) = (one for one in fields(load_command(command)) if one.name == "quiet")
    assert quiet.default is False


def test_a_missing_extra_is_named_with_the_command_that_installs_it():
    code = (
        "import sys; from g1stream.cli.main import main\n"
        "for name in sys.argv[1:]: print(main([name, '--help']), file=sys.stderr)"
    )
    path = os.pathsep.join([str(CORE_ALONE), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", code, *OF_EXTRAS],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    told = done.stderr.split("\n2\n")
    for row, said in zip(OF_EXTRAS.values(), told, strict=False):
        assert f"pip install 'g1stream[{row.home.split('.')[1]}]'" in said
    assert len(told) == len(OF_EXTRAS) + 1
