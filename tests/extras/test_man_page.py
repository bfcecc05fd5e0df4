import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from g1stream.cli.flags import command_parser
from g1stream.cli.main import COMMANDS, load_command

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "man" / "g1stream.1"


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="argparse writes flags in another way")
def test_it_is_made_of_the_help(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    tool = runpy.run_path(str(ROOT / "tools" / "make_man_page.py"))
    assert tool["man_page"]() == PAGE.read_text(), "run tools/make_man_page.py"


def test_it_shows_every_flag_as_it_is_typed():
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
