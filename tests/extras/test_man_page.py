"""The man page is that of the commands."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from g1stream.cli.flags import command_parser
from g1stream.cli.main import COMMANDS, load_command

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "man" / "g1stream.1"


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("make_man_page", ROOT / "tools/make_man_page.py")
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    return tool


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="argparse writes flags in another way")
def test_it_is_made_of_the_help(tool, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert tool.man_page() == PAGE.read_text(), "run tools/make_man_page.py"


def test_it_shows_every_flag_as_it_is_typed():
    """Also a line that begins with a dot or has a backslash: roff takes neither for its own."""
    if not shutil.which("man"):
        pytest.skip("man is not installed")
    done = subprocess.run(
        ["man", "--warnings", "-l", PAGE],
        capture_output=True,
        text=True,
        check=True,
        env={"PATH": "/usr/bin:/bin", "MANWIDTH": "100", "LC_ALL": "C.UTF-8"},
    )
    assert done.stderr == ""
    for name, row in COMMANDS.items():
        for action in command_parser(load_command(name), name, row.purpose)._actions:
            for option in action.option_strings:
                assert option in done.stdout


def test_roff_changes_nothing(tool):
    text = ".in 4\n'tis \\fB --flag\n"
    if not shutil.which("groff"):
        pytest.skip("groff is not installed")
    page = tool._HEAD + tool._verbatim(text)
    command = ["groff", "-man", "-Tascii", "-P-c"]
    shown = subprocess.run(command, input=page, capture_output=True, text=True, check=True).stdout
    for line in text.splitlines():
        assert line in shown
