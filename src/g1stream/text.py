"""Text output: wrapping, tables, and escaping of terminal control characters."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Final

from g1stream.input_limits import TEXT

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

__all__ = [
    "WIDTH",
    "counted",
    "labelled",
    "listed",
    "printable",
    "ranges",
    "short_name",
    "table",
    "told_apart",
]

WIDTH: Final = 80
"""Maximum width of a line in columns; only a single word may be longer."""


def printable(text: str) -> str:
    r"""Escape line breaks, control and invisible characters of a text, as in `\x1b`."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def counted(n: int, noun: str) -> str:
    """A number with its noun: `1 tick`, `2 ticks`."""
    return f"{n} {noun}{'s' * (n != 1)}"


def told_apart(value: float, limit: float) -> tuple[str, str]:
    """Two numbers with three decimals, or as many more as show that they differ."""
    for digits in range(3, 17):
        texts = f"{value:.{digits}f}", f"{limit:.{digits}f}"
        if value == limit or texts[0] != texts[1]:
            break
    return texts


def listed(names: Sequence[str], most: int = 20, noun: str = "") -> str:
    """Names as a list, cut after the first `most`: `a, b and 3 more`, or `3 more spans`."""
    shown, rest = ", ".join(names[:most]) or "nothing", len(names) - most
    more = counted(rest, f"more {noun}") if noun else f"{rest} more"
    return f"{shown} and {more}" if rest > 0 else shown


def ranges(spans: Sequence[tuple[int, int]], most: int) -> str:
    """Spans (first, last) as a list, cut after the first `most`: `0 to 3, 7 and 2 more spans`."""
    return listed([f"{a} to {b}" if a < b else f"{a}" for a, b in spans], most, "span")


def short_name(name: str) -> str:
    """Short name of a joint, link or limb for a title: `left knee`."""
    return name.removesuffix("_joint").removesuffix("_link").replace("_", " ")


def labelled(label: str, text: str) -> str:
    """A label and a text in lines of `WIDTH` columns, with the text wrapped beside the label.

    The text may come from a file or a peer, so control characters are escaped and a text longer
    than `TEXT` is cut.
    """
    shown = printable(text[:TEXT])
    return textwrap.fill(
        f"{shown} ..." if len(text) > TEXT else shown,
        WIDTH,
        initial_indent=label,
        subsequent_indent=" " * len(label),
        break_long_words=False,
        break_on_hyphens=False,
    )


def table(rows: Sequence[Sequence[str]], left: Collection[int]) -> list[str]:
    """Lines of a table; the columns `left` are left-aligned, and empty columns are left out."""
    columns = [
        [cell.ljust(width) if i in left else cell.rjust(width) for cell in column]
        for i, column in enumerate(zip(*rows, strict=True))
        if any(column[1:])
        for width in [max(map(len, column))]
    ]
    lines = ["  ".join(cells).rstrip() for cells in zip(*columns, strict=True)]
    return [lines[0], "  ".join("-" * len(column[0]) for column in columns), *lines[1:]]
