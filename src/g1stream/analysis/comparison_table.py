"""A comparison in words, and as text of 80 columns."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from g1stream.analysis.differences import SIGNIFICANT
from g1stream.analysis.render import labelled, table
from g1stream.text import counted, printable

if TYPE_CHECKING:
    from g1stream.analysis.comparison import Comparison
    from g1stream.analysis.differences import Difference

__all__ = ["compared", "comparison_table", "significance", "verdict"]

#: Joints whose RMSE differs most.
_MOST_JOINTS: Final = 8


def comparison_table(comparison: Comparison) -> str:
    """The verdict, what is compared, what else differs, and the differences."""
    by_change = sorted(comparison.joints.items(), key=lambda one: -abs(one[1].change or 0.0))
    kinds: tuple[dict[str, Difference], ...] = (
        comparison.metrics,
        {f"RMSE {name.replace('_', ' ')}": one for name, one in comparison.limbs.items()},
        {name.removesuffix("_joint"): one for name, one in by_change[:_MOST_JOINTS]},
    )
    rows: list[tuple[str, ...]] = [("", "base", "other", "unit", "change", "p (Holm)")]
    for kind in kinds:
        rows += [_row(name, one) for name, one in kind.items()]
        rows.append(("",) * len(rows[0]))
    lines = [
        labelled("verdict   ", verdict(comparison)),
        labelled("motion    ", compared(comparison)),
        labelled("base      ", ", ".join(comparison.base)),
        labelled("other     ", ", ".join(comparison.other)),
    ]
    lines += [
        labelled("differs   ", f"{name}: {base}; {other}")
        for name, (base, other) in comparison.differs.items()
    ]
    below = (
        "change: other - base, in % of base, or in the unit where a share says nothing; joints: "
        f"the {_MOST_JOINTS} whose RMSE differs most. {significance(comparison)}"
    )
    return "\n".join(
        [*lines, "", *map(printable, table(rows, left=(0, 3, 5))), labelled("", below)]
    )


def _row(name: str, one: Difference) -> tuple[str, ...]:
    change = f"{one.difference:+.3g}" if one.change is None else f"{one.change:+.1%}"
    p = "" if one.p_adjusted is None else _p(one.p_adjusted)
    mark = " *" if one.significant else ""
    return name, f"{one.base:.4g}", f"{one.other:.4g}", one.unit, change, p + mark


def verdict(comparison: Comparison) -> str:
    """What became of the tracking error, in one sentence."""
    rmse, joints = comparison.metrics["rmse"], comparison.joints.values()
    base, other = math.degrees(rmse.base), math.degrees(rmse.other)
    change = "" if rmse.change is None else f" ({rmse.change:+.1%})"
    text = f"The joints followed with an RMSE of {other:.3f} deg instead of {base:.3f}{change}"
    if rmse.p_adjusted is None:
        return f"{text}; whether that is more than noise, one session on a side cannot tell."
    noise = "more than" if rmse.significant else "not to be told from"
    closer = sum(bool(one.significant) and one.difference < 0.0 for one in joints)
    farther = sum(bool(one.significant) and one.difference > 0.0 for one in joints)
    return (
        f"{text}, {noise} the noise from run to run (p {_p(rmse.p_adjusted)}); of "
        f"{counted(len(joints), 'joint')} {closer} followed more closely and {farther} less "
        "closely, beyond that noise."
    )


def compared(comparison: Comparison) -> str:
    """Which part of which motion is compared."""
    return f"{comparison.motion}, {comparison.start_s:.2f} to {comparison.stop_s:.2f} s"


def significance(comparison: Comparison) -> str:
    """What the p-values are, or why there are none."""
    sides = len(comparison.base), len(comparison.other)
    if min(sides) < 2:
        return (
            f"With {sides[0]} and {sides[1]} sessions no difference can be told from the noise "
            "between runs: give two or more on each side."
        )
    return (
        f"* significant: p < {SIGNIFICANT:g} in Welch's t-test on {sides[0]} and {sides[1]} "
        "sessions, adjusted for the number of rows of a kind (Holm)."
    )


def _p(value: float) -> str:
    return "<0.001" if value < 0.001 else f"{value:.3f}"
