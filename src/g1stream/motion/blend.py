"""Smooth transitions: minimum jerk, coasting to rest, and the frames between two motions.

Both polynomials take a number or an array. The control loop uses numbers, which takes a third of
a microsecond. Frames use arrays.
"""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz
from g1stream.types import Floats

if TYPE_CHECKING:
    T = TypeVar("T", float, Floats)

__all__ = [
    "COAST",
    "MINIMUM_JERK_PEAK",
    "blend_frames",
    "coast",
    "minimum_jerk",
    "seam_frames",
]

COAST: Final = 0.2
"""Time in which a velocity at either end of a motion decays or is built up, s.

A velocity v overshoots by at most 0.2 * 0.2 s * v."""

MINIMUM_JERK_PEAK: Final = 15 / 8
"""Peak speed of a minimum-jerk path of length 1 in time 1."""

#: Highest speed of the minimum-jerk part of a seam: joints and the root's rotation in rad/s, the
#: root's translation in m/s.
_PEAK_SPEED: Final = 1.5
#: Shortest seam, s: both coasts and a blend between them.
_SHORTEST: Final = 0.5


def minimum_jerk(s: T) -> tuple[T, T, T]:
    """Progress from 0 to 1, its rate and its acceleration at the fraction `s` of a movement.

    The polynomial 10 s^3 - 15 s^4 + 6 s^5 starts and ends at rest without acceleration (T. Flash
    and N. Hogan, "The coordination of arm movements", 1985). It is at rest outside 0 to 1.
    """
    s = _unit(s)
    progress = s**3 * (10.0 + s * (-15.0 + 6.0 * s))
    rate = 30.0 * s**2 * (1.0 - s) ** 2
    acceleration = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    return progress, rate, acceleration


def coast(seconds: T, length: float | T) -> tuple[T, T, T]:
    """Distance, velocity and acceleration while a velocity of 1 decays to 0.

    The quintic Hermite polynomial T (x - 6 x^3 + 8 x^4 - 3 x^5), x = t / T. It starts with
    velocity 1 and without acceleration, and ends where it started, without both.

    Args:
        seconds: time since the start, s.
        length: duration T, s; at rest afterwards.
    """
    x = _unit(seconds / length)
    distance = length * x * (1.0 - x) ** 3 * (1.0 + 3.0 * x)
    velocity = 1.0 + x * x * (-18.0 + x * (32.0 - 15.0 * x))
    acceleration = x * (-36.0 + x * (96.0 - 60.0 * x)) / length
    return distance, velocity, acceleration


def seam_frames(linear: Floats, quat: Floats, fps: float) -> tuple[Floats, Floats]:
    """Append frames that lead from the last frame of a motion back to the first.

    They are made with `blend_frames`. They are not in the motion file, so they are only as long as
    the speeds require.

    Args:
        linear: (T, D) joint angles, rad, and root position, m.
        quat: (T, 4) root orientation, wxyz.
        fps: frames per second.

    Returns:
        Both arrays with S frames appended, (T + S, D) and (T + S, 4). The next frame after these is
        frame 0 again.
    """
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(xyzw_from_wxyz(quat[[-1, 0]]))
    turn = (rotation[0].inv() * rotation[1]).magnitude()
    furthest = max(float(np.abs(linear[0] - linear[-1]).max()), float(turn))
    seconds = max(_SHORTEST, furthest * MINIMUM_JERK_PEAK / _PEAK_SPEED)
    ends = (linear[-2:], linear[:2]), (quat[-2:], quat[:2])
    path, turned = blend_frames(*ends, fps, ceil(seconds * fps))
    return np.concatenate([linear, path]), np.concatenate([quat, turned])


def blend_frames(
    linear: tuple[Floats, Floats],
    quat: tuple[Floats, Floats],
    fps: float,
    n_steps: int,
    coasting: float | Floats = COAST,
) -> tuple[Floats, Floats]:
    """Frames that lead from the end of one motion to the start of another.

    Every joint coasts from its last velocity, moves to its first angle on a minimum-jerk path and
    accelerates to its first velocity. The root does the same.

    Args:
        linear: (2, D) and (2, D), the last two frames of the first motion and the first two of the
            second: joint angles, rad, and root position, m.
        quat: (2, 4) and (2, 4), the same frames' root orientation, wxyz.
        fps: frames per second.
        n_steps: number of steps between the motions, 2 or more.
        coasting: duration of each coast, s: a number, or (D,). It is limited to the time of all
            steps.

    Returns:
        (S, D) and (S, 4), S = n_steps - 1.
    """
    from scipy.spatial.transform import Rotation

    steps = np.arange(1.0, n_steps)[:, np.newaxis]
    blend = minimum_jerk(steps / n_steps)[0]

    def coasts(length: float | Floats) -> tuple[Floats, Floats]:
        length = np.minimum(length, n_steps / fps)
        return coast(steps / fps, length)[0], -coast((n_steps - steps) / fps, length)[0]

    (before, last), (first, after) = linear
    after_last, before_first = coasts(coasting)
    path = last + blend * (first - last)
    path = path + after_last * (last - before) * fps + before_first * (after - first) * fps

    before_r, last_r, first_r, after_r = Rotation.from_quat(xyzw_from_wxyz(np.concatenate(quat)))
    after_last, before_first = coasts(COAST)
    turned = (
        last_r
        * Rotation.from_rotvec(after_last * (before_r.inv() * last_r).as_rotvec() * fps)
        * Rotation.from_rotvec(blend * (last_r.inv() * first_r).as_rotvec())
        * Rotation.from_rotvec(before_first * (first_r.inv() * after_r).as_rotvec() * fps)
    )
    return path, wxyz_from_xyzw(turned.as_quat())


def _unit(x: T) -> T:
    """The value limited to 0 and 1."""
    if isinstance(x, np.ndarray):
        return np.clip(x, 0.0, 1.0)
    return min(1.0, max(0.0, x))
