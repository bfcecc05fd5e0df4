"""The help of a command, no wider than the terminal and 80 columns."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from io import StringIO

__all__ = ["KeptHelp", "wrapped", "wrapped_usage"]

_NO_BREAK = "\N{NO-BREAK SPACE}"


class KeptHelp(StringIO):
    """Keeps what tyro prints, with the lines and colours that standard output can show."""

    encoding = property(lambda self: self._output.encoding)

    def __init__(self) -> None:
        super().__init__()
        self._output = sys.stdout

    def isatty(self) -> bool:
        return self._output.isatty()


def wrapped_usage(usage: str) -> str:
    """The first line of tyro's help, wrapped between flags."""
    plain = re.sub(r"\x1b\[[\d;]*m", "", usage)
    together = re.sub(r"\[[^]]*\]|--\S+ \S+", lambda part: part[0].replace(" ", _NO_BREAK), plain)
    lines = textwrap.wrap(
        together,
        _width(),
        subsequent_indent=" " * 7,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(lines).replace(_NO_BREAK, " ")


def wrapped(text: str) -> str:
    """A text with its paragraphs as wide as the terminal, 80 columns at most.

    Paragraphs with indented lines, such as the examples, stay as they are.
    """
    return "\n\n".join(
        paragraph if "\n " in paragraph else textwrap.fill(paragraph, _width())
        for paragraph in text.split("\n\n")
    )


def _width() -> int:
    return min(80, shutil.get_terminal_size().columns)
