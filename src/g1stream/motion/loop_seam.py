"""The way back from a motion's last frame to its first, for a motion that repeats.

The seam is made of frames like the rest, so that one spline goes through all. Along it every joint
coasts out of its last velocity, moves to frame 0 on a minimum-jerk path (Flash and Hogan 1985), and
runs up to its first velocity; the root does the same, sliding and turning back to where it began.
The seam is our invention and not the motion's: it lasts only as long as these speeds ask for.
"""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.robot.rotations import wxyz_from_xyzw, xyzw_from_wxyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["seam_frames"]

#: The fastest that the minimum-jerk part moves: joints and the root's turning in rad/s, the root's
#: sliding in m/s.
_PEAK_SPEED: Final = 1.5
#: Seconds in which an end velocity v dies away; the overshoot it causes is 0.2 s * 0.2 v.
_COAST: Final = 0.2
#: No seam is shorter, seconds: room for both coasts and a blend between them.
_SHORTEST: Final = 0.5
#: A minimum-jerk path of length 1 in time 1 has this peak speed.
_MINIMUM_JERK_PEAK: Final = 15 / 8


def seam_frames(
    linear: NDArray[np.float64], quat: NDArray[np.float64], fps: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Append the seam to the frames of a motion.

    Args:
        linear: (T, D) joint angles, rad, and root position, m.
        quat: (T, 4) root orientation, wxyz.
        fps: frames a second.

    Returns:
        The same two with the seam's frames appended: (T + S, D) and (T + S, 4). One frame after the
        last of them comes frame 0 again.
    """
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(xyzw_from_wxyz(quat))
    way = linear[0] - linear[-1]
    turn = (rotation[-1].inv() * rotation[0]).as_rotvec()
    furthest = max(float(np.abs(way).max()), float(np.linalg.norm(turn)))
    seconds = max(_SHORTEST, furthest * _MINIMUM_JERK_PEAK / _PEAK_SPEED)
    n_steps = ceil(seconds * fps)
    steps = np.arange(1, n_steps)[:, np.newaxis]
    blend = _minimum_jerk(steps / n_steps)
    after_last = _coast(steps / fps)
    before_first = -_coast((n_steps - steps) / fps)

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


def _minimum_jerk(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """From 0 at x = 0 to 1 at x = 1, with no velocity and no acceleration at either end."""
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def _coast(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far something of unit velocity gets, t seconds on, while it is brought back to 0.

    The quintic Hermite basis of the first derivative: velocity 1 at t = 0 and 0 from `_COAST` on,
    no acceleration at either end.
    """
    x = np.minimum(t / _COAST, 1.0)
    return _COAST * x * (1.0 - x) ** 3 * (1.0 + 3.0 * x)
