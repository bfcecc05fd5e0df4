"""The soles of a motion on a flat floor: which corners touch it, and what they can carry.

The floor is at height 0. docs/motion-physics.md has the formulas and their sources.
"""

from __future__ import annotations

from functools import cache
from itertools import permutations
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Flags = NDArray[np.bool_]

__all__ = [
    "FRICTION",
    "beyond_support",
    "floor_forces",
    "touching",
    "zero_moment_point",
]

FRICTION: Final = 0.6
"""Coefficient of friction between sole and floor: rubber on a dry floor. Simulators have 1."""

#: A corner touches the floor once it is lower and slower than the first figures, and until it is
#: higher or faster than the second ones, m and m/s. Clips that were retargeted have standing feet
#: up to 2 cm above the floor, which slide by some 0.1 m/s.
_TOUCHES: Final = (0.02, 0.25)
_LEAVES: Final = (0.035, 0.5)

#: The share of the squared forces in what is minimised when the floor's force is distributed: so
#: small that the forces add up to what is needed within a millionth.
_EVEN: Final = 1e-6
#: Edges of the friction pyramid.
_EDGES: Final = np.array(
    [(FRICTION, 0, 1), (-FRICTION, 0, 1), (0, FRICTION, 1), (0, -FRICTION, 1)], dtype=float
)


def touching(corners: Floats, fps: float) -> tuple[Flags, Floats]:
    """Which corners touch the floor, and how fast each slides.

    With hysteresis, in height and in speed, so that noise about a threshold does not count as
    steps. Until a corner is first clearly on the floor or off it, it counts as it does then.

    Args:
        corners: (T, C, 3) m, world.
        fps: frames per second.

    Returns:
        (T, C) whether it touches; (T, C) horizontal speed, m/s, by central differences.
    """
    velocity = np.gradient(corners, axis=0) * fps
    height, speed = corners[..., 2], np.linalg.norm(velocity, axis=-1)
    on = (height < _TOUCHES[0]) & (speed < _TOUCHES[1])
    off = (height > _LEAVES[0]) | (speed > _LEAVES[1])
    frames = np.arange(len(corners))[:, np.newaxis]
    decided = np.where(on | off, frames, -1)
    first = np.argmax(decided >= 0, axis=0)
    latest = np.maximum(np.maximum.accumulate(decided, axis=0), first)
    return np.take_along_axis(on, latest, axis=0), np.linalg.norm(velocity[..., :2], axis=-1)


def zero_moment_point(force: Floats, moment: Floats) -> Floats:
    """Where on the floor a force would have no moment about a horizontal axis.

    Args:
        force: (..., 3) N, world, of the floor on the robot.
        moment: (..., 3) N·m, world, about the world's origin.

    Returns:
        (..., 2) m; not finite where the force has no vertical part.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        point: Floats = np.stack([-moment[..., 1], moment[..., 0]], axis=-1) / force[..., 2:]
    return point


def beyond_support(points: Floats, corners: Floats, touches: Flags) -> Floats:
    """How far points are outside of the convex hull of the corners that touch, seen from above.

    The distance of a point p from a convex set is the largest n . p - max_c n . c of all directions
    n, which for corners c is that of a normal of a line through two of them, or of p - c. Inside
    it is negative, and says how far the nearest edge is.

    Args:
        points: (T, 2) m.
        corners: (T, C, 3) m.
        touches: (T, C); of a frame in which none does the result means nothing.

    Returns:
        (T,) m.
    """
    n_corners = corners.shape[1]
    # A corner that does not touch stands where one that does stands: the hull is the same.
    substitute = np.where(touches, np.arange(n_corners), touches.argmax(axis=1)[:, np.newaxis])
    hull = np.take_along_axis(corners[..., :2], substitute[..., np.newaxis], axis=1)
    lines = (hull[:, j] - hull[:, i] for i, j in permutations(range(n_corners), 2))
    normals = (np.stack([line[:, 1], -line[:, 0]], axis=-1) for line in lines)
    radii = (points - hull[:, i] for i in range(n_corners))
    beyond = np.full(len(points), -np.inf)
    for direction in (*normals, *radii):
        length = np.linalg.norm(direction, axis=-1)
        reach = np.einsum("ti,tci->tc", direction, hull).max(axis=1)
        ahead = np.einsum("ti,ti->t", direction, points) - reach
        with np.errstate(divide="ignore", invalid="ignore"):
            beyond = np.fmax(beyond, np.where(length > 1e-9, ahead / length, np.nan))
    return beyond


def floor_forces(corners: Floats, force: Floats, moment: Floats) -> Floats:
    """Distribute a force and a moment, as far as they can be, over corners that touch the floor.

    Each corner pushes within a friction pyramid of four edges, inscribed in the cone of `FRICTION`.
    Of all distributions with the same sum this is the one with the least squared forces
    (non-negative least squares, Lawson and Hanson 1974), so that feet that stand alike carry alike.

    Args:
        corners: (C, 3) m, world, C >= 1.
        force: (3,) N, world, that the floor should exert.
        moment: (3,) N·m, world, about the world's origin.

    Returns:
        (C, 3) N, world, of the floor on each corner.
    """
    from scipy.optimize import lsq_linear, nnls

    centre = corners.mean(axis=0)
    edges, known = _even_pushes(len(corners))
    factors = known.copy()
    x, y, z = np.repeat(corners - centre, len(_EDGES), axis=0).T
    along_x, along_y, along_z = edges.T
    factors[3] = y * along_z - z * along_y
    factors[4] = z * along_x - x * along_z
    factors[5] = x * along_y - y * along_x
    asked = np.zeros(len(factors))
    asked[:3], asked[3:6] = force, moment - np.cross(centre, force)
    try:
        shares, _ = nnls(factors, asked)
    except RuntimeError:  # it may go in circles where corners all but coincide
        shares = lsq_linear(factors, asked, bounds=(0.0, np.inf)).x
    forces: Floats = (shares[:, np.newaxis] * edges).reshape(len(corners), -1, 3).sum(axis=1)
    return forces


@cache
def _even_pushes(n_corners: int) -> tuple[Floats, Floats]:
    """Edges of the pyramids (E, 3) at so many corners, and what is known of `factors` (6 + E, E).

    Its first rows sum the forces along the edges, the next three their moments, which are left at
    zero; the others ask for each to be small.
    """
    edges = np.tile(_EDGES, (n_corners, 1))
    even = np.sqrt(_EVEN) * np.eye(len(edges))
    return edges, np.vstack([edges.T, np.zeros_like(edges.T), even])
