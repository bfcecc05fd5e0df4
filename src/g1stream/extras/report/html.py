"""What the pages share: their frame, their figures, and text from files as HTML."""

from __future__ import annotations

import base64
import gzip
import json
from datetime import datetime, timezone
from html import escape
from importlib import resources
from string import Template
from typing import TYPE_CHECKING, Any

from g1stream._version import __version__
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.text import printable, short_name

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

__all__ = [
    "details",
    "escaped",
    "facts",
    "figure",
    "joint_choice",
    "missing",
    "page",
    "template",
    "text_table",
]


def page(title: str, heading: str, content: str, drawn: Sequence[Any], overview: str = "") -> str:
    """A page that needs no network, with the script that draws its figures.

    Args:
        title: of the browser's tab, plain text.
        heading: plain text.
        content: HTML.
        drawn: what the script draws, for JSON; `figure` counts from its first.
        overview: HTML below the heading.
    """
    from plotly.offline import get_plotlyjs

    return template("page.html").substitute(
        title=escaped(title),
        heading=escaped(heading),
        made=escaped(f"g1stream {__version__}, {datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC"),
        style=_resource("report.css"),
        overview=overview,
        content=content,
        plotly=_packed(get_plotlyjs()),
        figures=_packed(json.dumps(drawn)),
        script=_resource("report.js"),
    )


def template(name: str) -> Template:
    """A file of this directory with places to fill."""
    return Template(_resource(name))


def figure(name: str, caption: str, number: int = 0) -> str:
    """The place of a figure; the script has a function of its name.

    Args:
        name: of the function.
        caption: HTML.
        number: which of the data in `page` it draws.
    """
    return (
        f"<figure><figcaption>{caption}</figcaption>"
        f'<div data-figure="{name}" data-drawn="{number}"></div></figure>'
    )


def joint_choice(first: int, shown: Container[str]) -> str:
    """A list to choose the joint of a figure from.

    Args:
        first: index of the joint that is chosen at first.
        shown: names of those in the list.
    """
    limbs = {
        limb: [joint for joint in joints if JOINT_NAMES[joint] in shown]
        for limb, joints in JOINT_GROUPS.items()
    }
    groups = "".join(
        f'<optgroup label="{limb.replace("_", " ")}">'
        + "".join(
            f'<option value="{joint}"{" selected" * (joint == first)}>'
            f"{short_name(JOINT_NAMES[joint])}</option>"
            for joint in joints
        )
        + "</optgroup>"
        for limb, joints in limbs.items()
        if joints
    )
    return f'<select aria-label="joint">{groups}</select>'


def facts(labelled: Iterable[tuple[str, str]]) -> str:
    """Labels and what they stand for, plain text; empty without any."""
    rows = "".join(
        f"<dt>{escaped(label)}</dt><dd>{escaped(text)}</dd>\n" for label, text in labelled
    )
    return f"<dl>\n{rows}</dl>" if rows else ""


def text_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of plain text whose last column wraps."""

    def cells(texts: Sequence[str], tag: str) -> str:
        return "".join(f'<{tag} class="text">{escaped(text)}</{tag}>' for text in texts)

    body = "".join(f"<tr>{cells(row, 'td')}</tr>\n" for row in rows)
    return (
        f'<div class="wide"><table class="texts"><thead><tr>{cells(heads, "th")}</tr></thead>\n'
        f"<tbody>{body}</tbody></table></div>"
    )


def details(summary: str, content: str) -> str:
    """What is folded until a reader opens it, or prints; empty without content."""
    return f"<details><summary>{summary}</summary>{content}</details>" if content else ""


def missing(reason: str | None) -> str:
    """Why something is not there; empty without a reason."""
    return f'<p class="missing">{escaped(reason)}</p>' if reason else ""


def escaped(text: str) -> str:
    """What may come from a file or a peer, as HTML."""
    return escape(printable(text))


def _packed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), 6, mtime=0)).decode()


def _resource(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
