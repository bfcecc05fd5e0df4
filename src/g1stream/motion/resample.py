"""A motion at another rate, a piece at a time, so that memory does not grow with its length."""

from __future__ import annotations

from fractions import Fraction
from math import ceil, floor
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.errors import MotionError
from g1stream.motion.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from g1stream.motion.motion import Motion
    from g1stream.motion.trajectory import TrajectoryPoint

__all__ = ["resample"]

#: Frames of one piece.
_PIECE: Final = 256
#: Frames before and after a piece that its spline is fitted through as well. The pull of a frame on
#: a cubic spline fades by a factor of 3.7 a frame: beyond 32, nothing is left in float64.
_MARGIN: Final = 32


def resample(
    motion: Motion, rate: float, start: int, stop: int
) -> Iterator[tuple[range, TrajectoryPoint]]:
    """Sample the spline through a motion's frames at the times i / rate.

    Args:
        motion: what to sample; frame k is at the time k / fps.
        rate: samples a second, Hz.
        start: the frame from which the times run.
        stop: the frame before which they end; that is, they run to frame `stop - 1`.

    Yields:
        Sample numbers i, in order, and the samples (a row each), a piece at a time. Numbers and
        samples of a part of a motion are those of the whole.

    Raises:
        MotionError: there is no sample in this part of the motion, or the rate is not above 0.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise MotionError(
            f"The motion {motion.name} cannot be sampled at {rate} Hz.",
            "Give a rate above 0, such as 100.",
        )
    samples_per_frame = Fraction(repr(float(rate))) / Fraction(repr(float(motion.fps)))
    last = stop - 1
    end = floor(last * samples_per_frame) + 1
    if ceil(start * samples_per_frame) >= end:
        raise MotionError(
            f"At {rate:g} Hz there is no sample between the frames {start} and {last} of "
            f"{motion.name}.",
            "Give a higher rate, or more frames.",
        )
    for first in range(start, last, _PIECE):
        behind = min(first + _PIECE, last)
        upper = end if behind == last else ceil(behind * samples_per_frame)
        numbers = range(ceil(first * samples_per_frame), upper)
        if not numbers:
            continue
        lowest = max(0, first - _MARGIN)
        part = motion.frames(lowest, min(motion.n_frames, behind + _MARGIN + 1))
        trajectory = Trajectory(part)
        times = np.arange(numbers.start, numbers.stop) / rate - lowest / motion.fps
        # Rounding must not put the last sample behind the end, where the trajectory rests.
        yield numbers, trajectory.sample_many(np.minimum(times, trajectory.duration))
