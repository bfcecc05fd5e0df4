"""Writes configs/sim.toml and robot.toml, every setting with its value, from g1stream.config.

python tools/make_configs.py
"""

from __future__ import annotations

import json
import textwrap
from typing import TYPE_CHECKING, Any

from g1stream.config import SHIPPED, Config, accepted, settings

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

_HEADS = {
    "sim": """\
# For a simulator on this machine: what g1stream does without any config file on the loopback
# interface. Every setting is below, commented out, with its value, or with
# an example if it is unset.
""",
    "robot": """\
# For a real G1, with cautious limits. Read docs/real-robot.md and docs/safety.md first.
# g1stream does the same without any config file on an interface that is not the loopback.
# Below, commented out, are the settings that a simulator has otherwise.
""",
}
_HEAD = """\
# Copy what you want to change; what a file leaves out keeps its value, and flags go over it.
# Made by tools/make_configs.py from g1stream/config.py; edit the settings there.
"""
#: The settings that are set: the receiver, and where it is.
_SET = {
    "sim": {"profile": "simulator", "dds.domain": 1, "dds.interface": "lo"},
    "robot": {"profile": "robot", "dds.domain": 0, "dds.interface": "eth0"},
}


def config_toml(name: str) -> str:
    """The text of configs/NAME.toml."""
    text, table, given = _HEADS[name] + _HEAD, "", _SET[name]
    for key, field in settings().items():
        extra: Any = field.json_schema_extra
        value = given.get(key, extra["robot"] if name == "robot" and extra else field.default)
        if name == "robot" and key not in given and value == field.default:
            continue
        group, _, setting = key.rpartition(".")
        if group != table:
            table, model = group, Config.model_fields[group].annotation
            text += "\n" + _comment(" ".join((model.__doc__ or "").split()))
            text += f"[{table}]\n" if table != "gains" else ""
        if table == "gains":
            text += f"[{key}]\n"
            continue
        text += ("" if table else "\n") + _comment(_meaning(field))
        value = (field.examples or [None])[0] if value is None else value
        text += f"{'' if key in given else '#'}{setting} = {json.dumps(value)}\n"
    return text


def _meaning(field: FieldInfo) -> str:
    extra: Any = field.json_schema_extra
    unit = extra["unit"]
    notes = ", ".join(filter(None, (unit, accepted(field))))
    description = field.description or ""
    text = f"{description[0].upper()}{description[1:]}" + (f" ({notes})." if notes else ".")
    return f"{text} Unset by default." if field.default is None else text


def _comment(text: str) -> str:
    return textwrap.fill(text, 98, initial_indent="# ", subsequent_indent="# ") + "\n"


if __name__ == "__main__":
    for name in _HEADS:
        (SHIPPED / f"{name}.toml").write_text(config_toml(name))
