"""Writes man/g1stream.1, the man page, from the help of all commands.

python tools/make_man_page.py
"""

from __future__ import annotations

import os
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from g1stream.cli.flags import command_parser
from g1stream.cli.main import COMMANDS, load_command, main

PAGE = Path(__file__).resolve().parents[1] / "man" / "g1stream.1"

#: A man page indents by seven columns.
_COLUMNS = 72
_HEAD = r"""
.TH G1STREAM 1 "" g1stream
.SH NAME
g1stream \- play a reference motion on a Unitree G1 over DDS, and know how well it went
.SH SYNOPSIS
.B g1stream
.I COMMAND
[\fIOPTIONS\fR] ...
.SH DESCRIPTION
""".lstrip()


def man_page() -> str:
    """The text of the man page, in the macros of man(7)."""
    os.environ["COLUMNS"] = str(_COLUMNS)
    with redirect_stdout(StringIO()) as overview:
        main(["--help"])
    _, _, about = overview.getvalue().partition("\n\n")
    page = _HEAD + _verbatim(about) + ".SH COMMANDS\n"
    for name, row in COMMANDS.items():
        parser = command_parser(load_command(name), name, row.purpose)
        page += f".SS g1stream {name}\n" + _verbatim(parser.format_help())
    return page


def _verbatim(text: str) -> str:
    """Lines as they are: what roff would take for a request or an escape is escaped."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-").replace("'", r"\(aq")
    lines = [rf"\&{line}" if line.startswith(".") else line for line in escaped.splitlines()]
    return "\n".join([".nf", *lines, ".fi", ""])


if __name__ == "__main__":
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(man_page())
