"""Differences of figures between two sets of sessions, and which are more than noise.

Whether a difference is more than the noise from run to run is told by Welch's t-test (B. Welch,
Biometrika, 1947) on one value for each session: samples within a session are far from independent,
and the two sides need not be equally noisy. Of several values that are tested together (29 joints,
5 limbs, those of the whole session) the p-values are adjusted by Holm's method (S. Holm,
Scandinavian Journal of Statistics, 1979), so that one of many joints does not stand out by chance.
A permutation test would ask for less, but of five sessions a side its least p-value is 2/252, which
29 joints adjust to 0.23: it could never tell anything.
"""

from __future__ import annotations

import math
from statistics import fmean
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import computed_field

from g1stream.session.records import Record

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from g1stream.types import Floats

__all__ = ["SIGNIFICANT", "Difference", "differences", "ranked"]

SIGNIFICANT: Final = 0.05
"""A difference with an adjusted p-value below this is significant."""


class Difference(Record):
    """A figure on both sides.

    Attributes:
        unit: of the values.
        base, other: mean over the sessions of a side.
        base_values, other_values: of each session.
        change: (other - base) / base; None where base is 0, or the figure can have either sign, so
            that a share of it says nothing.
        p: of Welch's t-test; None with one session on a side.
        p_adjusted: by Holm's method, over the figures of the same kind.
    """

    unit: str
    base: float
    other: float
    base_values: list[float]
    other_values: list[float]
    change: float | None = None
    p: float | None = None
    p_adjusted: float | None = None

    @computed_field  # type: ignore[prop-decorator]
    @property
    def difference(self) -> float:
        """Other - base."""
        return self.other - self.base

    @computed_field  # type: ignore[prop-decorator]
    @property
    def significant(self) -> bool | None:
        """Whether it is more than the noise from run to run; None where that cannot be told."""
        return None if self.p_adjusted is None else self.p_adjusted < SIGNIFICANT


def differences(
    sides: Sequence[Sequence[Mapping[str, float | None]]],
    units: Mapping[str, str],
    signed: Collection[str] = (),
) -> dict[str, Difference]:
    """Of the figures that all sessions of both sides have, tested together.

    Args:
        sides: of base and other, the figures of each session by name.
        units: by name; what has none is in rad.
        signed: names of those that can have either sign.
    """
    found: dict[str, Difference] = {}
    for name in sides[0][0]:
        values = [[v for one in side if (v := one.get(name)) is not None] for side in sides]
        if [len(side) for side in values] != [len(side) for side in sides]:
            continue
        base, other = map(fmean, values)
        found[name] = Difference(
            unit=units.get(name, "rad"),
            base=base,
            other=other,
            base_values=values[0],
            other_values=values[1],
            change=(other - base) / base if base and name not in signed else None,
            p=_welch(*map(np.array, values)),
        )
    # Holm: the k-th smallest of n p-values counts n + 1 - k times, and no less than those before.
    ordered = sorted((d for d in found.values() if d.p is not None), key=lambda d: d.p or 0.0)
    least = 0.0
    for i, one in enumerate(ordered):
        least = max(least, min(1.0, (len(ordered) - i) * (one.p or 0.0)))
        one.p_adjusted = least
    return found


def ranked(found: Mapping[str, Difference]) -> dict[str, Difference]:
    """Significant differences first, and of each kind the greatest first.

    A share of the base would put a joint first that follows to 1e-7 rad on one side.
    """
    key = lambda one: (not one[1].significant, -abs(one[1].difference))  # noqa: E731
    return dict(sorted(found.items(), key=key))


def _welch(a: Floats, b: Floats) -> float | None:
    """The two-sided p-value of Welch's t-test; None with one value on a side."""
    from scipy.special import stdtr

    if min(len(a), len(b)) < 2:
        return None
    errors = [one.var(ddof=1) / len(one) for one in (a, b)]
    apart, error = abs(a.mean() - b.mean()), sum(errors)
    # A figure that is the same in all sessions of a side, such as a rate, has no noise.
    if error <= np.square(1e-12 * np.abs(np.concatenate([a, b])).max()):
        return 1.0 if apart <= 1e-12 * np.abs(a).max() else 0.0
    degrees = error**2 / sum(
        one**2 / (len(values) - 1) for one, values in zip(errors, (a, b), strict=True)
    )
    return float(2.0 * stdtr(degrees, -apart / math.sqrt(error)))
