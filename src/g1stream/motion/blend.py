"""Smooth transitions: minimum jerk, coasting to rest, and the seam of a motion that repeats.

Both polynomials take a number or an array. The control loop needs numbers, which cost it a third of
a microsecond; the seam needs arrays.
"""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.types import Floats

if TYPE_CHECKING:
    T = TypeVar("T", float, Floats)

__all__ = ["COAST", "MINIMUM_JERK_PEAK", "coast", "minimum_jerk", "seam_frames"]

COAST: Final = 0.2
"""Seconds in which a velocity at either end of a motion dies away or is built up.

The overshoot of a velocity v is 0.2 * 0.2 s * v at most."""

MINIMUM_JERK_PEAK: Final = 15 / 8
"""Peak speed of a minimum-jerk path of length 1 in time 1."""

#: Highest speed of the minimum-jerk part of a seam: joints and the root's rotation in rad/s, the
#: root's translation in m/s.
_PEAK_SPEED: Final = 1.5
#: No seam is shorter, s: room for both coasts and a blend between them.
_SHORTEST: Final = 0.5


def minimum_jerk(s: T) -> tuple[T, T, T]:
    """Progress from 0 to 1, its rate and its acceleration at the fraction `s` of a movement.

    The polynomial 10 s^3 - 15 s^4 + 6 s^5 starts and ends at rest without acceleration: T. Flash
    and N. Hogan, "The coordination of arm movements", 1985. Beyond 0 and 1 it rests.
    """
    s = _unit(s)
    progress = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
    rate = 30.0 * s**2 * (1.0 - s) ** 2
    acceleration = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    return progress, rate, acceleration


def coast(seconds: T, length: float) -> tuple[T, T, T]:
    """Distance, velocity and acceleration while a velocity of 1 is brought to 0.

    The quintic Hermite polynomial that starts with velocity 1 and without acceleration, and ends
    with neither, where it started: T (x - 6 x^3 + 8 x^4 - 3 x^5) of x = t / T.

    Args:
        seconds: since the start, s.
        length: how long it takes, s; then it rests.
    """
    x = _unit(seconds / length)
    distance = length * x * (1.0 - x) ** 3 * (1.0 + 3.0 * x)
    velocity = 1.0 + x * x * (-18.0 + x * (32.0 - 15.0 * x))
    acceleration = x * (-36.0 + x * (96.0 - 60.0 * x)) / length
    return distance, velocity, acceleration


def seam_frames(linear: Floats, quat: Floats, fps: float) -> tuple[Floats, Floats]:
    """Append to the frames of a motion those that lead from the last back to the first.

    Every joint coasts out of its last velocity, moves to frame 0 on a minimum-jerk path and is
    brought up to its first velocity; the root does the same. These frames are not in the motion
    file, so that they take only as long as the speeds need.

    Args:
        linear: (T, D) joint angles, rad, and root position, m.
        quat: (T, 4) root orientation, wxyz.
        fps: frames per second.

    Returns:
        The same two with S frames appended, (T + S, D) and (T + S, 4). One frame after the last of
        them is frame 0 again.
    """
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(xyzw_from_wxyz(quat))
    way = linear[0] - linear[-1]
    turn = (rotation[-1].inv() * rotation[0]).as_rotvec()
    furthest = max(float(np.abs(way).max()), float(np.linalg.norm(turn)))
    seconds = max(_SHORTEST, furthest * MINIMUM_JERK_PEAK / _PEAK_SPEED)
    n_steps = ceil(seconds * fps)
    steps = np.arange(1.0, n_steps)[:, np.newaxis]
    blend = minimum_jerk(steps / n_steps)[0]
    after_last = coast(steps / fps, COAST)[0]
    before_first = -coast((n_steps - steps) / fps, COAST)[0]

    first_vel, last_vel = (linear[1] - linear[0]) * fps, (linear[-1] - linear[-2]) * fps
    path = linear[-1] + blend * way + after_last * last_vel + before_first * first_vel

    first_rate = (rotation[0].inv() * rotation[1]).as_rotvec() * fps
    last_rate = (rotation[-2].inv() * rotation[-1]).as_rotvec() * fps
    turned = (
        rotation[-1]
        * Rotation.from_rotvec(after_last * last_rate)
        * Rotation.from_rotvec(blend * turn)
        * Rotation.from_rotvec(before_first * first_rate)
    )
    return (
        np.concatenate([linear, path]),
        np.concatenate([quat, wxyz_from_xyzw(turned.as_quat())]),
    )


def _unit(x: T) -> T:
    """The value limited to 0 and 1."""
    if isinstance(x, np.ndarray):
        return np.clip(x, 0.0, 1.0)
    return min(1.0, max(0.0, x))
