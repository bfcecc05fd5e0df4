"""Hooks of MkDocs: formulas as MathML, tables of records, links to files outside of docs/.

mkdocs.yml names this file. A formula needs no script in the browser, so that the site works without
a network.
"""

from __future__ import annotations

import html
import re
from importlib import import_module
from typing import Any

from latex2mathml.converter import convert
from pydantic import BaseModel

_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL
)
_FIELDS = re.compile(r"^\{\{ fields (\S+) \}\}$", re.MULTILINE)
_ABOVE = re.compile(r"\[([^\]]+)\]\(\.\./(?!docs/)([^)]+)\)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put a table in place of `{{ fields g1stream.MotionRow }}`, a path in place of a link."""
    markdown = _FIELDS.sub(lambda match: _fields(match[1]), markdown)
    # The site holds docs/ only. On a forge, these links lead to the file.
    return _ABOVE.sub(lambda match: f"`{match[2]}`", markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Make MathML of the formulas of a page."""
    return _FORMULA.sub(_mathml, content)


def _mathml(match: re.Match[str]) -> str:
    inline, block = match[2], match[3]
    display = "inline" if block is None else "block"
    return str(convert(html.unescape(inline if block is None else block), display=display))


def _fields(name: str) -> str:
    """A table of the fields of a pydantic record, which its source declares by functions."""
    module, _, kind = name.rpartition(".")
    record: type[BaseModel] = getattr(import_module(module), kind)
    lines = ["| field | type | default | unit | meaning |", "|---|---|---|---|---|"]
    for key, field in record.model_fields.items():
        extra = field.json_schema_extra
        unit = extra.get("unit", "") if isinstance(extra, dict) else ""
        default = "" if field.is_required() or field.default is None else f"`{field.default!r}`"
        kind = str(record.__annotations__.get(key, "")).replace("|", "\\|")
        lines.append(f"| `{key}` | `{kind}` | {default} | {unit} | {field.description or ''} |")
    return "\n".join(lines)
