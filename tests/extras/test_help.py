import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from cli_help import check_help
from g1stream.cli.flags import command_parser
from g1stream.cli.main import COMMANDS, load_command

CORE_ALONE = Path(__file__).parents[1] / "core_alone"
#: The commands that can write a file.
WRITES = {
    *("demo", "stream", "record", "convert", "library", "attach", "report", "plot"),
    *("simulate", "fit", "render", "layout"),
}
OF_EXTRAS = {name: row for name, row in COMMANDS.items() if row.extra}


@pytest.mark.parametrize("command", OF_EXTRAS)
def test_help_has_examples_and_exit_codes_within_80_columns(command, monkeypatch, capsys):
    check_help(command, monkeypatch, capsys)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_quiet(command):
    (quiet,) = (one for one in fields(load_command(command)) if one.name == "quiet")
    assert quiet.default is False


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_its_output_as_o_and_its_result_as_json(command):
    flags = command_parser(load_command(command), command, "")._option_string_actions
    assert "--json" in flags
    assert ("-o" in flags) == (command in WRITES)
    if "-o" in flags:
        assert {"--out", "--record"} & {*flags["-o"].option_strings}


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
        assert f"pip install 'g1stream[{row.extra}]'" in said
    assert len(told) == len(OF_EXTRAS) + 1
