"""The page of a library: its motions as a table to sort and filter, worst first."""

from __future__ import annotations

import json
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, Final, get_args

from g1stream.files import complete_file
from g1stream.library.rows import MotionRow
from g1stream.library.table import open_library
from g1stream.text import printable
from g1stream.types import Support

if TYPE_CHECKING:
    import pandas

__all__ = ["PAGE", "write_page"]

PAGE: Final = "index.html"

_FIRST: Final = ["picture", "name", "variant", "status", "reason", "report", "output"]
_LEFT_OUT: Final = {"key", "sha256", "command", "support", "limits"}
#: The same for all rows of a page, or told by another column.
_LAST: Final = ["path", "seconds", "memory"]


def write_page(directory: Path) -> Path:
    """Write the page of a library, which needs no network.

    Args:
        directory: of the library.

    Raises:
        RecordingError: there is no library, or the page cannot be written.
    """
    motions = open_library(directory).motions
    commands = {
        command: _shown(motions[motions["command"] == command])
        for command in dict.fromkeys(motions["command"])
    }
    text = Template(_resource("page.html")).substitute(
        title=escape(printable(directory.absolute().name)),
        style=_resource("page.css"),
        data=json.dumps(commands, allow_nan=False).replace("<", "\\u003c"),
        script=_resource("page.js"),
    )
    path = directory / PAGE
    with complete_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def _shown(motions: pandas.DataFrame) -> dict[str, Any]:
    """The columns that have values, and the rows, worst first."""
    motions = motions.iloc[_badness(motions).argsort(kind="stable")[::-1]]
    told = motions.replace("", None).notna().any()
    used = [name for name in motions if name not in _LEFT_OUT and told[name]]
    names = [name for name in _FIRST if name in used]
    names += [name for name in used if name not in {*_FIRST, *_LAST}]
    names += [name for name in _LAST if name in used]
    about = {name: MotionRow.model_fields.get(name) for name in names}
    return {
        "columns": [
            {
                "name": name,
                "about": field.description if field else "value of the sweep",
                "unit": field.json_schema_extra["unit"] if field else "",  # type: ignore[index]
            }
            for name, field in about.items()
        ],
        "rows": json.loads(motions[names].to_json(orient="values", double_precision=9)),
    }


def _badness(motions: pandas.DataFrame) -> Any:
    """(N,) numbers: what failed has the highest, then what cannot be played or followed closely."""
    forbidden = sum((motions[support] == "no").astype(float) for support in get_args(Support))
    failed = (motions["status"] != "ok").astype(float)
    detail = motions["rmse"].fillna(motions["max_collision"] / 1e3).fillna(0.0).clip(0.0, 0.99)
    return (10.0 * failed + forbidden + detail).to_numpy()


def _resource(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
