"""The frame rate of files that do not say it, by times of the frames or by joint speeds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.input_limits import LATEST_NS

if TYPE_CHECKING:
    from g1stream.types import Floats

__all__ = ["rate_of_speeds", "rate_of_times"]

#: Units of time per second; with these, each step of time has one unit that gives a rate between
#: these limits.
_UNITS: Final = (1.0, 1e3, 1e6, 1e9)
_RATES: Final = (2.0, 2000.0)
#: Steps between times differ by less than this fraction of their mean; two decimals of 30 fps
#: differ by a sixth.
_JITTER: Final = 0.5
#: Times within this fraction of a whole rate have that rate; further if they are rounded more.
_ROUNDING: Final = 2e-4
#: Rates of cameras, training and controllers. A speed is a difference over some frames, so that
#: it gives a rate within this fraction.
_USUAL: Final = np.array([24.0, 25.0, 30.0, 50.0, 60.0, 100.0, 120.0, 200.0, 240.0, 250.0, 500.0])
_ABOUT: Final = 0.018
#: Frames over which speeds are added up, and the least correlations with the way of the joints,
#: for a usual rate and for another one.
_FRAMES: Final = 10
_ALIKE, _EXACT = 0.99, 0.996


def rate_of_times(times: Floats) -> float | None:
    """The rate of frames at times (T,), in s, ms, us or ns, Hz; None if they do not rise evenly.

    None also for numbers of frames, whose steps are 1.
    """
    if len(times) < 2 or not (np.abs(times) < LATEST_NS).all():  # False for NaN
        return None
    steps = np.diff(times)
    if (steps <= 0.0).any():
        return None
    mean = float(times[-1] - times[0]) / steps.size
    jitter = float(np.abs(steps - mean).max())
    if (steps == 1.0).all() or jitter > _JITTER * mean:
        return None
    rate = next((one for unit in _UNITS if _RATES[0] <= (one := unit / mean) < _RATES[1]), None)
    rounding = max(_ROUNDING, jitter / float(times[-1] - times[0]))
    if rate and abs(rate - round(rate)) < rounding * rate:
        return float(round(rate))
    return rate


def rate_of_speeds(angles: Floats, speeds: Floats) -> float | None:
    """The rate at which speeds (T, n), rad/s, are those of angles (T, n), Hz; None if at none.

    It is the usual rate near the least-squares factor between the way of the joints over ten
    frames and the sum of their speeds, by the trapezoidal rule; with little noise also another one.
    """
    n_frames = min(_FRAMES, len(angles) - 1)
    sums = np.zeros(angles.shape)
    sums[1:] = np.cumsum((speeds[1:] + speeds[:-1]) / 2.0, axis=0)
    way, summed = (one[n_frames:] - one[:-n_frames] for one in (angles, sums))
    product = float((way * summed).sum())
    squares = float((way**2).sum()), float((summed**2).sum())
    alike = product / max(np.sqrt(squares[0] * squares[1]), np.finfo(float).tiny)
    if not alike > _ALIKE:  # also for NaN
        return None
    rate = product / squares[0]
    usual = float(_USUAL[np.abs(_USUAL - rate).argmin()])
    if abs(usual - rate) < _ABOUT * usual:
        return usual
    return max(1.0, float(round(rate))) if alike > _EXACT else None  # noise lowers the factor
