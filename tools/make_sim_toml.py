"""Writes configs/sim.toml, every setting with its default, from the fields of g1stream.config.

python tools/make_sim_toml.py
"""

from __future__ import annotations

import json
import textwrap
from typing import TYPE_CHECKING, Any

from g1stream.config import SHIPPED, Config, accepted, settings

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

_HEAD = """\
# Every setting, with its default: what g1stream does without any config file.
# Copy what you want to change; what a file leaves out keeps its default, and flags go over it.
# Settings that are unset by default are commented out.
# Made by tools/make_sim_toml.py from g1stream/config.py; edit the settings there.
"""


def sim_toml() -> str:
    """The text of configs/sim.toml."""
    text, table = _HEAD, ""
    for key, field in settings().items():
        group, _, name = key.rpartition(".")
        if group != table:
            table, model = group, Config.model_fields[group].annotation
            text += "\n" + _comment(" ".join((model.__doc__ or "").split()))
            text += f"[{table}]\n" if table != "gains" else ""
        if table == "gains":
            text += f"[{key}]\n"
            continue
        text += ("" if table else "\n") + _comment(_meaning(field))
        unset = field.default is None
        value = (field.examples or [None])[0] if unset else field.default
        text += f"{'#' if unset else ''}{name} = {json.dumps(value)}\n"
    return text


def _meaning(field: FieldInfo) -> str:
    extra: Any = field.json_schema_extra
    notes = ", ".join(filter(None, (extra["unit"], accepted(field))))
    description = field.description or ""
    return f"{description[0].upper()}{description[1:]}" + (f" ({notes})." if notes else ".")


def _comment(text: str) -> str:
    return textwrap.fill(text, 98, initial_indent="# ", subsequent_indent="# ") + "\n"


if __name__ == "__main__":
    (SHIPPED / "sim.toml").write_text(sim_toml())
