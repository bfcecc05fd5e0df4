"""Writes the tables of docs/ whose values the program uses.

docs/support.md is a whole page, of what can be combined. Other pages have a table between two
comments: the profiles in safety.md, the gains in tracking.md, the names of arrays in formats.md.

python tools/make_support_page.py
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Any, Final, get_args

from g1stream.config import settings
from g1stream.control.combinations import combinations
from g1stream.extras.formats import evidence
from g1stream.profiles import PROFILES, ProfileConstants
from g1stream.robot.joints import EXAMPLE_KD, EXAMPLE_KP, JOINT_NAMES, TORQUE_LIMIT
from g1stream.types import Support

DOCS: Final = Path(__file__).parents[1] / "docs"
PAGE: Final = DOCS / "support.md"

_HEAD: Final = """\
# What can be combined

This page says which robot can be played how, and where that was tried. `stream`, `demo` and
`rollout` refuse what is not here. tools/make_support_page.py makes it from
src/g1stream/control/combinations.toml, which the program uses.

**No combination was tried on a robot.**

"""
_COLUMNS: Final = (
    *("what plays", "flags", "joints of the robot", "held", "other settings"),
    *("off loopback", "in lockstep", "over DDS"),
)
_FLAGS: Final = {
    ("motion", "lowcmd"): "-",
    ("motion", "arm_sdk"): "`--via arm_sdk`",
    ("feet", "lowcmd"): "`--support feet`",
    ("policy", "lowcmd"): "`--policy FILE`",
}


def support_page() -> str:
    """The text of docs/support.md."""
    rows = [
        _row(_FLAGS[source, receiver], about)
        for source, receivers in combinations().items()
        for receiver, about in receivers.items()
    ]
    return _HEAD + _table(_COLUMNS, rows)


def with_tables(page: str, name: str) -> str:
    """The text of a page, with its table made anew between the two comments."""
    begin, end = "<!-- made by tools/make_support_page.py -->\n", "<!-- end of table -->"
    before, _, rest = page.partition(begin)
    return f"{before}{begin}{TABLES[name]()}{end}{rest.partition(end)[2]}"


def profile_table() -> str:
    """What differs between the profiles: settings, then constants."""
    rows = []
    for name, field in settings().items():
        about: Any = field.json_schema_extra
        if name != "profile" and about and about["robot"] != field.default:
            text, _, _ = str(field.description).partition(";")
            values = [_value(field.default), _value(about["robot"])]
            rows.append([f"`{name}`", *values, ", ".join(filter(None, [text, about["unit"]]))])
    texts = re.findall(r"^ {8}(\w[\w, ]*): ((?:.|\n {12})+)", ProfileConstants.__doc__ or "", re.M)
    about_constant = {
        name: " ".join(text.split()) for names, text in texts for name in names.split(", ")
    }
    for name, simulator, robot in zip(
        ProfileConstants._fields, PROFILES["simulator"], PROFILES["robot"], strict=True
    ):
        text = about_constant[name].partition(";")[0].rstrip(".")
        words = name.replace("max_", "maximum_").replace("_", " ")
        text = f"{words} {text}" if text.startswith("of ") else text
        rows.append([name, _value(simulator), _value(robot), text])
    return _table(("name", "simulator", "robot", "what"), rows)


def gains_table() -> str:
    """The gains and torque limits without `[gains]`, one row for equal neighbours."""
    values = dict.fromkeys(re.sub("^(left|right)_", "", name) for name in JOINT_NAMES)
    for name, *row in zip(JOINT_NAMES, EXAMPLE_KP, EXAMPLE_KD, TORQUE_LIMIT, strict=True):
        values[re.sub("^(left|right)_", "", name)] = row
    rows = [
        [", ".join(name.removesuffix("_joint") for name, _ in group), *(f"{n:g}" for n in row)]
        for row, group in groupby(values.items(), key=lambda one: one[1])
    ]
    return _table(("joints", "kp, N·m/rad", "kd, N·m·s/rad", "motor's torque limit, N·m"), rows)


def arrays_table() -> str:
    """The names by which a file's arrays are found."""
    names: dict[str, Iterable[str]] = {
        "joint angles": [name for name in evidence._ANGLES if name != "table"],  # a CSV's
        "joint speeds": evidence._SPEEDS,
        "position of the pelvis": evidence._POSITIONS,
        "orientation of the pelvis": evidence._QUATS,
        "positions of bodies": (*evidence._BODY_POSITIONS, *evidence._LOCAL_POSITIONS),
        "orientations of bodies": evidence._BODY_QUATS,
        "names of joints": evidence._NAMES,
        "names of bodies": evidence._BODY_NAMES,
        "frame rate": (*evidence._FPS, "dt"),
    }
    rows = [[what, ", ".join(f"`{name}`" for name in found)] for what, found in names.items()]
    return _table(("what", "names"), rows)


#: The pages with a table, and what makes it.
TABLES: Final = {
    "safety.md": profile_table,
    "tracking.md": gains_table,
    "formats.md": arrays_table,
}


def _table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    columns = list(columns)
    lines = [f"| {' | '.join(row)} |" for row in (columns, *rows)]
    return "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]]) + "\n"


def _value(value: Any) -> str:
    if value is None:
        return "unset"
    if isinstance(value, tuple):
        return ", ".join(map(_value, value))
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def _row(flags: str, about: dict[str, Any]) -> list[str]:
    held = about.get("support", list(get_args(Support)))
    if "feet" in flags:
        held = ["nothing"]
    return [
        about["what"],
        flags,
        ", ".join(about["kinds"]),
        ", ".join(held) or "its own controller",
        ", ".join(_limits(about)) or "any",
        "yes" if about["network"] else "only `--profile network-simulator`",
        "tried" if about["lockstep"] else "-",
        "; ".join(about["dds"]),
    ]


def _limits(about: dict[str, Any]) -> list[str]:
    """What a row says about settings other than the support."""
    settings = ("joints", "others", "loop", "feedforward")
    found = []
    for name in settings:
        if name in about:
            values = " or ".join(str(one).lower() for one in about[name])
            found.append(f"`{name}` {values or 'unset'}")
    return found if about.get("gains", True) else [*found, "its own gains"]


if __name__ == "__main__":
    PAGE.write_text(support_page(), encoding="utf-8")
    for name in TABLES:
        page = DOCS / name
        text = page.read_text(encoding="utf-8")
        page.write_text(with_tables(text, name), encoding="utf-8")
