"""The page of a library: its motions as a table to sort and filter, worst first."""

from __future__ import annotations

import json
from collections.abc import Iterator
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, Final, get_args

from g1stream.extras.library.table import MotionRow, newest_motions
from g1stream.files import complete_file
from g1stream.text import printable
from g1stream.types import Support

if TYPE_CHECKING:
    import pandas

PAGE: Final = "index.html"

#: Where the page has the data, which are written in pieces of so many rows.
_DATA: Final = "\0"
_ROWS: Final = 500
#: The page has a reason in place of what is behind.
_FIRST: Final = [*("picture", "name", "status", "support"), *("reason", "rmse", "report", "output")]
_LEFT_OUT: Final = {"key", "sha256", "command", "limits"}
#: The same for many rows, or told by another column.
_LAST: Final = ["frames", "fps", "path", "seconds", "memory"]


def write_page(directory: Path) -> Path:
    """Write the page of a library, which needs no network."""
    motions = newest_motions(directory)
    text = Template(_resource("page.html")).substitute(
        title=escape(printable(directory.absolute().name)),
        style=_resource("page.css"),
        data=_DATA,
        script=_resource("page.js"),
    )
    before, _, after = text.partition(_DATA)
    path = directory / PAGE
    with complete_file(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(before)
        for number, command in enumerate(dict.fromkeys(motions["command"])):
            file.write(f"{',' if number else '{'}{json.dumps(command)}:")
            for piece in _shown(motions[motions["command"] == command]):
                file.write(piece.replace("<", "\\u003c"))
        file.write("}" + after)
    return path


def _shown(motions: pandas.DataFrame) -> Iterator[str]:
    """JSON of the columns that have values and of the rows, worst first, in pieces."""
    motions = motions.iloc[(-_badness(motions)).argsort(kind="stable")]
    told = motions.replace("", None).notna().any()
    used = [name for name in motions if name not in _LEFT_OUT and told[name]]
    names = [name for name in _FIRST if name in used]
    names += [name for name in used if name not in {*_FIRST, *_LAST}]
    names += [name for name in _LAST if name in used]
    about: dict[str, Any] = {name: MotionRow.model_fields[name] for name in names}
    columns = [
        {"name": name, "about": field.description, "unit": field.json_schema_extra["unit"]}
        for name, field in about.items()
    ]
    yield f'{{"columns":{json.dumps(columns)},"rows":['
    for first in range(0, len(motions), _ROWS):
        rows = motions[names].iloc[first : first + _ROWS]
        text = rows.to_json(orient="values", double_precision=9)
        yield f"{',' if first else ''}{text[1:-1]}"
    yield "]}"


def _badness(motions: pandas.DataFrame) -> Any:
    """(N,) numbers: what failed has the highest, then what cannot be played or followed closely."""
    forbidden = sum((motions[support] == "no").astype(float) for support in get_args(Support))
    failed = (motions["status"] != "ok").astype(float)
    detail = motions["rmse"].fillna(motions["max_collision"] / 1e3).fillna(0.0).clip(0.0, 0.99)
    return (10.0 * failed + forbidden + detail).to_numpy()


def _resource(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
