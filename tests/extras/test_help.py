"""The commands of extras: their help, and what is said where an extra is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cli_help import check_help
from g1stream.cli.main import COMMANDS

CORE_ALONE = Path(__file__).parents[1] / "core_alone"
OF_EXTRAS = {name: row for name, row in COMMANDS.items() if row.home.startswith("extras.")}


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "g1stream", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "COLUMNS": "80", **environment},
    )


@pytest.mark.slow
@pytest.mark.parametrize("command", OF_EXTRAS)
def test_help_has_examples_and_exit_codes_within_80_columns(command):
    check_help(command, run(command, "--help"))
    check_help(command, run(command, "--help-all"))


@pytest.mark.parametrize("command", OF_EXTRAS)
def test_a_missing_extra_is_named_with_the_command_that_installs_it(command):
    path = os.pathsep.join([str(CORE_ALONE), os.environ.get("PYTHONPATH", "")])
    done = run(command, "--help", PYTHONPATH=path)
    extra = OF_EXTRAS[command].home.split(".")[1]
    assert done.returncode == 2
    assert f"pip install 'g1stream[{extra}]'" in done.stderr
    assert "Traceback" not in done.stderr
