"""Writes src/g1stream/__init__.pyi: where type checkers find each name that g1stream exports.

python tools/make_stub.py
"""

from __future__ import annotations

from pathlib import Path

import g1stream

STUB = Path(g1stream.__file__).with_suffix(".pyi")


def stub() -> str:
    """The text of g1stream/__init__.pyi."""
    lines = [
        f"from g1stream.{module} import {name} as {name}"
        for name, module in sorted(g1stream._HOME.items(), key=lambda item: (item[1], item[0]))
    ]
    lines += [f"from g1stream.extras import {name} as {name}" for name in g1stream._EXTRAS]
    version = "from g1stream._version import __version__ as __version__"
    head = "# Made by `make docs`."
    own = ("__all__: list[str]", "_HOME: dict[str, str]", "_EXTRAS: tuple[str, ...]")
    return "\n".join([head, *sorted([*lines, version]), "", *own]) + "\n"


if __name__ == "__main__":
    STUB.write_text(stub())
