"""By how much a robot is behind its reference: cross-correlation of joint positions.

For each joint and each of a row of delays, the measured position is correlated with that of the
reference so long ago. The delay is the one that leaves the least unexplained, to a fraction of the
row's step by a parabola through it and its neighbours. Scale and mean of a joint do not matter: one
that moves less than asked, or hangs lower, is not late.

The interval of confidence is that of least squares whose residuals are correlated: each second
counts as one observation, so that a disturbance that lasts is not taken for many (K.-Y. Liang and
S. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika, 1986).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from g1stream.types import Floats
from g1stream.view.tracking_error import MAX_GAP_NS

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Delay", "Delays", "interpolated"]

#: Delays that are searched, in steps: from -0.02 to 0.2 s; positive: the robot is behind.
_STEP: Final = 0.005
_LAGS: Final = np.arange(-4, 41)
#: Every second of the times that are a step apart is compared, or so few that there are no more.
_STRIDE: Final = 2
_MOST_TIMES: Final = 20_000
#: A joint takes part if reference and measurement span more than this, rad.
_MOVES: Final = 0.05
#: An observation, s, and how few give no interval of confidence.
_BLOCK: Final = 1.0
_FEWEST_BLOCKS: Final = 5


class Delay(NamedTuple):
    """By how much the robot is behind the reference, and how well it follows apart from that.

    Attributes:
        seconds: positive where the robot is behind.
        ci95: half the width of the 95 % interval of confidence, s; None where less than five
            seconds were compared.
        correlation: 0 to 1, of the measurement with the reference `seconds` ago.
        rmse: (J,) rad, of the reference `seconds` ago - measured.
        std: (J,) rad, the same without each joint's mean error.
    """

    seconds: float
    ci95: float | None
    correlation: float
    rmse: Floats
    std: Floats


class Delays:
    """Finds the delay of any joints together.

    Args:
        times: (R,) s, rising, of the reference in every phase: a robot that is late shows what was
            asked before the motion.
        q: (R, J) rad, the reference.
        state_times: (N,) s, rising, of the states that are compared.
        measured: (N, J) rad.
    """

    def __init__(self, times: Floats, q: Floats, state_times: Floats, measured: Floats) -> None:
        first = max(state_times[0], times[0] + _LAGS[-1] * _STEP)
        last = min(state_times[-1], times[-1] + _LAGS[0] * _STEP)
        steps = int((last - first) / _STEP + 1e-9)  # negative where too little was recorded
        at = first + _STEP * np.arange(0, steps + 1, max(_STRIDE, -(-steps // _MOST_TIMES)))
        after = np.searchsorted(state_times, at).clip(1, max(1, len(state_times) - 1))
        self._at = at[np.diff(state_times, append=np.inf)[after - 1] <= MAX_GAP_NS / 1e9]
        self._rows = np.round((self._at - first) / _STEP).astype(np.intp)
        self._moving = np.zeros(q.shape[1], dtype=bool)
        if not len(self._at):
            return
        # Of the reference the grid begins so much earlier that there is a row for each delay.
        grid = first + _STEP * np.arange(-_LAGS[-1], steps + 1 - _LAGS[0])
        self._q = interpolated(grid, times, q)
        self._measured = interpolated(self._at, state_times, measured)
        middle = self._q.mean(axis=0)  # so that sums of squares keep their digits
        self._q -= middle
        self._measured -= middle
        self._total = self._measured.var(axis=0)
        self._mean = self._measured.mean(axis=0)
        self._moving = np.minimum(np.ptp(self._q, axis=0), np.ptp(self._measured, axis=0)) > _MOVES
        every = list(range(q.shape[1]))
        self._unexplained = np.array([self._regress(lag, every)[1] for lag in _LAGS.tolist()])

    def of(self, joints: Sequence[int]) -> Delay | None:
        """The delay of some joints together; None where none moves or no delay fits best."""
        moving = [joint for joint in joints if self._moving[joint]]
        if not moving:
            return None
        costs = self._unexplained[:, moving].sum(axis=1)
        best = int(costs.argmin())
        if not 0 < best < len(costs) - 1:
            return None
        left, middle, right = costs[best - 1 : best + 2]
        curvature = left - 2.0 * middle + right
        fraction = 0.5 * (left - right) / curvature if curvature > 0.0 else 0.0
        shift = float(_LAGS[best] + fraction)
        error = self._reference(shift, list(joints)) - self._measured[:, list(joints)]
        explained = 1.0 - middle / self._total[moving].sum()
        return Delay(
            seconds=shift * _STEP,
            ci95=self._ci95(shift, moving),
            correlation=float(np.sqrt(np.clip(explained, 0.0, 1.0))),
            rmse=np.sqrt(np.mean(np.square(error), axis=0)),
            std=error.std(axis=0),
        )

    def _reference(self, shift: float, joints: list[int]) -> Floats:
        """(T, J) the reference of some joints so many steps before each time."""
        whole = int(np.floor(shift))
        rows, weight = self._rows + _LAGS[-1] - whole, shift - whole
        columns = self._q if len(joints) == self._q.shape[1] else self._q[:, joints]
        q: Floats = columns[rows]
        return q + weight * (columns[rows - 1] - q) if weight else q

    def _regress(self, shift: float, joints: list[int]) -> tuple[Floats, Floats]:
        """Of some joints (J,) the factor on the reference, and the variance left unexplained."""
        q, mean = self._reference(shift, joints), self._mean[joints]
        measured = self._measured if len(joints) == len(self._mean) else self._measured[:, joints]
        of_q = q.mean(axis=0)
        variance = np.einsum("tj,tj->j", q, q) / len(q) - np.square(of_q)
        covariance = np.einsum("tj,tj->j", q, measured) / len(q) - of_q * mean
        factor: Floats = covariance.clip(0.0) / np.maximum(variance, np.finfo(float).tiny)
        unexplained: Floats = self._total[joints] - factor * covariance
        return factor, unexplained

    def _ci95(self, shift: float, joints: list[int]) -> float | None:
        from scipy.special import stdtrit

        blocks = ((self._at - self._at[0]) / _BLOCK).astype(np.intp)
        starts = np.flatnonzero(np.diff(blocks, prepend=-1))
        if len(starts) < _FEWEST_BLOCKS:
            return None
        factor = self._regress(shift, joints)[0]
        expected = factor * self._reference(shift, joints)
        slope = self._reference(shift - 0.5, joints) - self._reference(shift + 0.5, joints)
        slope *= factor / _STEP
        error = self._measured[:, joints] - expected
        error -= error.mean(axis=0)
        scores = np.add.reduceat((error * slope).sum(axis=1), starts)
        information = np.square(slope).sum()
        spread = np.sqrt(np.square(scores).sum() * len(starts) / (len(starts) - 1.0))
        return float(stdtrit(len(starts) - 1.0, 0.975) * spread / information)


def interpolated(at: Floats, times: Floats, values: Floats) -> Floats:
    """(T, J) values (R, J) of increasing times (R,) at other times (T,), linearly."""
    return np.column_stack([np.interp(at, times, column) for column in values.T])
