"""Writes docs/support.md, the table of what can be combined, from g1stream.control.combinations.

python tools/make_support_page.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, get_args

from g1stream.control.combinations import combinations
from g1stream.types import Support

PAGE: Final = Path(__file__).parents[1] / "docs" / "support.md"

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
    head = [f"| {' | '.join(_COLUMNS)} |", "|---" * len(_COLUMNS) + "|"]
    return _HEAD + "\n".join([*head, *rows]) + "\n"


def _row(flags: str, about: dict[str, Any]) -> str:
    held = about.get("support", list(get_args(Support)))
    if "feet" in flags:
        held = ["nothing"]
    cells = [
        about["what"],
        flags,
        ", ".join(about["kinds"]),
        ", ".join(held) or "its own controller",
        ", ".join(_limits(about)) or "any",
        "yes" if about["network"] else "only `--profile network-simulator`",
        "tried" if about["lockstep"] else "-",
        "; ".join(about["dds"]),
    ]
    return f"| {' | '.join(cells)} |"


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
