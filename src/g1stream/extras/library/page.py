"""The HTML page of a library: a table of motions to sort and filter, worst first."""

from __future__ import annotations

import json
from html import escape
from importlib import resources
from pathlib import Path, PurePosixPath
from string import Template
from typing import TYPE_CHECKING, Any, Final, get_args

from g1stream.extras.library.table import MotionRow, newest_motions
from g1stream.files import complete_file
from g1stream.text import printable
from g1stream.types import Support

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import pandas

__all__ = ["PAGE", "write_page"]

PAGE: Final = "index.html"

#: Placeholder for the data in the page, and number of rows per piece.
_DATA: Final = "\0"
_ROWS: Final = 500
#: Columns before and after the values of a sweep. The page shows a reason instead of the latter.
_FIRST: Final = ["picture", "name", "status", "support", "policy", "variant"]
_THEN: Final = ["reason", "rmse", "report", "output"]
_LEFT_OUT: Final = {"key", "sha256", "command", "limits"}
#: Columns that are equal for many rows, or redundant.
_LAST: Final = ["frames", "fps", "path", "policy_sha256", "seconds", "memory"]


def write_page(directory: Path) -> Path:
    """Write the page of a library. It needs no network.

    Args:
        directory: the library's directory.

    Raises:
        RecordingError: there is no library, or the page cannot be written.
    """
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
    """JSON of the non-empty columns and of the rows, worst first, in pieces."""
    motions = motions.assign(name=_distinct(motions["name"], motions["path"]))
    sweep = [name for name in motions if name not in MotionRow.model_fields]
    motions = motions.iloc[(-_badness(motions)).argsort(kind="stable")]
    told = motions.replace("", None).notna().any()
    told["variant"] &= not told["support"]  # redundant, as are values of a sweep
    used = [name for name in motions if name not in _LEFT_OUT and told[name]]
    ahead = [*_FIRST, *sweep, *_THEN]
    names = [name for name in ahead if name in used]
    names += [name for name in used if name not in {*ahead, *_LAST}]
    names += [name for name in _LAST if name in used]
    about = {name: MotionRow.model_fields.get(name) for name in names}
    columns = [
        {
            "name": name,
            "about": field.description if field else "value of the sweep",
            "unit": field.json_schema_extra["unit"] if field else "",  # type: ignore[index]
        }
        for name, field in about.items()
    ]
    yield f'{{"columns":{json.dumps(columns)},"rows":['
    for first in range(0, len(motions), _ROWS):
        rows = motions[names].iloc[first : first + _ROWS]
        text = rows.to_json(orient="values", double_precision=9)
        yield f"{',' if first else ''}{text[1:-1]}"
    yield "]}"


def _distinct(names: Sequence[str], paths: Sequence[str]) -> list[str]:
    """Names, preceded by the part of the path that distinguishes files with the same name."""
    files: dict[str, set[str]] = {}
    for name, path in zip(names, paths, strict=True):
        files.setdefault(name, set()).add(path)
    return [
        name if len(files[name]) == 1 else _end(path, files[name])
        for name, path in zip(names, paths, strict=True)
    ]


def _end(path: str, others: set[str]) -> str:
    parts = {one: PurePosixPath(one).parts for one in others}
    for n in range(2, len(parts[path])):
        if len({one[-n:] for one in parts.values()}) == len(parts):
            return "/".join(parts[path][-n:])
    return path


def _badness(motions: pandas.DataFrame) -> Any:
    """(N,) sort keys: failed rows highest, then those that cannot be played or tracked well."""
    forbidden = sum((motions[support] == "no").astype(float) for support in get_args(Support))
    failed = (motions["status"] != "ok").astype(float)
    detail = motions["rmse"].fillna(motions["max_collision"] / 1e3).fillna(0.0).clip(0.0, 0.99)
    return (10.0 * failed + forbidden + detail).to_numpy()


def _resource(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
