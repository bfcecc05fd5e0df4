"""A comparison in words, and as text of 80 columns."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Literal

from g1stream.extras.report.differences import SIGNIFICANT
from g1stream.text import counted, labelled, printable, table

if TYPE_CHECKING:
    from g1stream.extras.report.compare import Comparison
    from g1stream.extras.report.differences import Difference

__all__ = ["compared", "comparison_table", "significance", "verdict"]

#: Joints whose RMSE differs most.
_MOST_JOINTS: Final = 8
#: From this share of the base on a change is said as how many times the base.
_MANY_TIMES: Final = 9.0
#: Significant digits of an RMSE, and with how many it can be told from another.
_FEWEST_DIGITS, _MOST_DIGITS = 4, 7


def comparison_table(comparison: Comparison) -> str:
    """The verdict, what is compared, what else differs, and the differences."""
    kinds: tuple[dict[str, Difference], ...] = (
        comparison.metrics,
        {f"RMSE {name.replace('_', ' ')}": one for name, one in comparison.limbs.items()},
        {
            name.removesuffix("_joint"): one
            for name, one in list(comparison.joints.items())[:_MOST_JOINTS]
        },
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
        "change: other - base, in % of base or, from tenfold on, other / base; in the unit where a "
        "share says nothing; joints: "
        f"the {_MOST_JOINTS} whose RMSE differs most, significant ones first; *: significant. "
        f"{significance(comparison)}"
    )
    return "\n".join(
        [*lines, "", *map(printable, table(rows, left=(0, 3, 5))), labelled("", below)]
    )


def _share(change: float) -> str:
    return f"{change:+.1%}" if change < _MANY_TIMES else f"x{1.0 + change:.3g}"


def _row(name: str, one: Difference) -> tuple[str, ...]:
    change = f"{one.difference:+.3g}" if one.change is None else _share(one.change)
    p = "" if one.p_adjusted is None else _p(one.p_adjusted)
    mark = " *" if one.significant else ""
    return name, f"{one.base:.4g}", f"{one.other:.4g}", one.unit, change, p + mark


def verdict(comparison: Comparison, unit: Literal["rad", "deg"] = "rad") -> str:
    """What became of the tracking error, in one sentence."""
    rmse, joints = comparison.metrics["rmse"], comparison.joints.values()
    base, other = (math.degrees(x) if unit == "deg" else x for x in (rmse.base, rmse.other))
    for digits in range(_FEWEST_DIGITS, _MOST_DIGITS + 1):
        figures = f"{other:.{digits}g}", f"{base:.{digits}g}"
        if figures[0] != figures[1]:
            change = "" if rmse.change is None else f" ({_share(rmse.change)})"
            text = f"an RMSE of {figures[0]} {unit} instead of {figures[1]}{change}"
            break
    else:
        text = f"the same RMSE on both sides, {base:.{_FEWEST_DIGITS}g} {unit}"
    text = f"The joints followed with {text}"
    if figures[0] == figures[1] and not rmse.significant:
        return f"{text}."
    if rmse.p_adjusted is None:
        return f"{text}; whether that is more than noise, one session on a side cannot tell."
    noise = "more than" if rmse.significant else "which cannot be told from"
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
        f"Significant is p < {SIGNIFICANT:g} in Welch's t-test on {sides[0]} and {sides[1]} "
        "sessions, adjusted for the number of rows of a kind (Holm)."
    )


def _p(value: float) -> str:
    return "<0.001" if value < 0.001 else f"{value:.3f}"
