"""Hooks of MkDocs: formulas as MathML, tables of records, files from outside of docs/.

mkdocs.yml names this file. A formula needs no script in the browser, so that the site works without
a network.
"""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from latex2mathml.converter import convert
from pydantic import BaseModel

ROOT = Path(__file__).parents[1]
#: Files outside of docs/ that have a page, and the page.
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
}
_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL
)
_FIELDS = re.compile(r"^\{\{ fields (\S+) \}\}$", re.MULTILINE)
#: On a forge, the sentence before a file says what the site puts there.
_HERE = r"^(?:The site puts .* here:\n\n)?"
_FILE = re.compile(_HERE + r"\{\{ file (\S+) \}\}$", re.MULTILINE)
_NOTEBOOK = re.compile(_HERE + r"\{\{ notebook (\S+) \}\}$", re.MULTILINE)
_LINK = re.compile(r"\[([^\]]+)\]\(([^)#:]+)(#[^)]*)?\)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put a table, file or notebook in place of `{{ fields ... }}`, `{{ file ... }}` and so on."""
    markdown = _NOTEBOOK.sub(lambda match: _notebook(match[1]), markdown)
    markdown = _FIELDS.sub(lambda match: _fields(match[1]), markdown)
    markdown = _FILE.sub(lambda match: _file(match[1]), markdown)
    # Comments behind commands are aligned in the source; a page has less room.
    markdown = re.sub(r"^((?:    )?\S.*?) {3,}# ", r"\1  # ", markdown, flags=re.MULTILINE)
    # The site holds docs/ only. Links to other files are for a forge; here they become the path.
    return re.sub(r"(?<!!)\[[^\]]+\]\(\.\./([^)]+)\)", r"`\1`", markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Make MathML of the formulas of a page."""
    return _FORMULA.sub(_mathml, content)


def _file(name: str) -> str:
    """A file of the repository's root, with its links as they are from docs/."""

    def moved(match: re.Match[str]) -> str:
        text, target, anchor = match[1], match[2], match[3] or ""
        path = target.removeprefix("docs/") if target.startswith("docs/") else PAGES.get(target)
        return f"[{text}]({path or '../' + target}{anchor})"

    return _LINK.sub(moved, (ROOT / name).read_text(encoding="utf-8"))


def _notebook(name: str) -> str:
    """The cells of a notebook and their outputs: text, pictures and videos."""
    parts: list[str] = []
    for cell in json.loads((ROOT / name).read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "text" in output:
                parts.append(f"```text\n{''.join(output['text']).rstrip()}\n```")
            elif "image/png" in data:
                picture = "".join(data["image/png"]).replace("\n", "")
                parts.append(f'<img alt="output" src="data:image/png;base64,{picture}">')
            elif "text/html" in data:
                parts.append("".join(data["text/html"]))
    return "\n\n".join(parts)


def _mathml(match: re.Match[str]) -> str:
    inline, block = match[2], match[3]
    display = "inline" if block is None else "block"
    return str(convert(html.unescape(inline if block is None else block), display=display))


def _fields(name: str) -> str:
    """A table of the fields of a pydantic record, which its source declares by functions."""
    record: type[BaseModel] = resolve_name(name)
    lines = ["| field | type | default | unit | meaning |", "|---|---|---|---|---|"]
    for key, field in record.model_fields.items():
        extra = field.json_schema_extra
        unit = extra.get("unit", "") if isinstance(extra, dict) else ""
        default = "" if field.is_required() or field.default is None else f"`{field.default!r}`"
        kind = str(record.__annotations__.get(key, "")).replace("|", "\\|")
        lines.append(f"| `{key}` | `{kind}` | {default} | {unit} | {field.description or ''} |")
    return "\n".join(lines)
