"""A comparison as text of 80 columns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from g1stream.analysis.render import WIDTH, labelled
from g1stream.text import printable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from g1stream.analysis.comparison import Comparison, Difference

__all__ = ["SIGNIFICANT", "table"]

SIGNIFICANT: Final = 0.05
"""A difference with an adjusted p-value below this is significant."""

#: Joints whose RMSE differs most.
_MOST_JOINTS: Final = 8


def table(comparison: Comparison) -> str:
    """What is compared, what else differs, and the differences."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    rows = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    rows.add_column("")
    for name in ("base", "other", "unit", "change", "p (Holm)"):
        rows.add_column(name, justify="left" if name == "unit" else "right")
    by_change = sorted(comparison.joints.items(), key=lambda one: -abs(one[1].change or 0.0))
    kinds: tuple[Mapping[str, Difference], ...] = (
        comparison.metrics,
        {f"RMSE {name.replace('_', ' ')}": one for name, one in comparison.limbs.items()},
        {name.removesuffix("_joint"): one for name, one in by_change[:_MOST_JOINTS]},
    )
    for kind in kinds:
        for name, one in kind.items():
            change = "" if one.change is None else f"{one.change:+.1%}"
            p = "" if one.p_adjusted is None else _p(one.p_adjusted)
            mark = " *" if one.significant else ""
            rows.add_row(name, f"{one.base:.4g}", f"{one.other:.4g}", one.unit, change, p + mark)
        rows.add_section()
    console = Console(width=WIDTH, color_system=None, force_terminal=False)
    with console.capture() as captured:
        console.print(rows)
    lines = [
        labelled("motion    ", _compared(comparison)),
        labelled("base      ", ", ".join(comparison.base)),
        labelled("other     ", ", ".join(comparison.other)),
    ]
    lines += [
        labelled("differs   ", f"{name}: {base}; {other}")
        for name, (base, other) in comparison.differs.items()
    ]
    below = f"joints: the {_MOST_JOINTS} whose RMSE differs most. {_significance(comparison)}"
    text = captured.get().rstrip()
    return "\n".join([*lines, *map(printable, text.split("\n")), "", labelled("", below)])


def _p(value: float) -> str:
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def _compared(comparison: Comparison) -> str:
    return f"{comparison.motion}, {comparison.start_s:.2f} to {comparison.stop_s:.2f} s"


def _significance(comparison: Comparison) -> str:
    sides = len(comparison.base), len(comparison.other)
    if min(sides) < 2:
        return (
            f"With {sides[0]} and {sides[1]} sessions no difference can be told from the noise "
            "between runs: give two or more on each side."
        )
    return (
        f"*: p < {SIGNIFICANT:g}, Welch's t-test on {sides[0]} and {sides[1]} sessions, "
        "adjusted for the number of rows of a kind (Holm)."
    )
