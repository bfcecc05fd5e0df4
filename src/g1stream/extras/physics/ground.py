"""The soles of a motion on a flat floor: which corners touch it, and what they can carry.

The floor is at height 0. docs/physics.md has the formulas and their sources.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from g1stream.types import Floats

Flags = NDArray[np.bool_]

FRICTION: Final = 0.6
"""Coefficient of friction between sole and floor: rubber on a dry floor. Simulators have 1."""

TRUSTED_FRICTION: Final = 0.4
"""What a robot that stands trusts the floor with: less than there mostly is."""

#: A corner touches the floor once it is lower and slower than the first figures, and until it is
#: higher or faster than the second ones, m and m/s. Clips that were retargeted have standing feet
#: up to 2 cm above the floor, which slide by some 0.1 m/s.
_TOUCHES: Final = (0.02, 0.25)
_LEAVES: Final = (0.035, 0.5)

#: Frames at once, which the cache of a processor holds.
_PIECE: Final = 256
#: The share of the squared forces in what is minimised when the floor's force is distributed: so
#: small that the forces add up to what is needed within a millionth, and their moments, whose
#: levers are short, within a ten-thousandth.
_EVEN: Final = 1e-6
#: After so many rounds Newton's method goes in circles; of 3,500 frames of a dance in 140.
_ROUNDS: Final = 12
#: Edges of the friction pyramid.
_EDGES: Final = np.array(
    [(FRICTION, 0, 1), (-FRICTION, 0, 1), (0, FRICTION, 1), (0, -FRICTION, 1)], dtype=float
)
#: A lever (3,) times this (3, 12) is its cross product with each edge.
_LEVERS: Final = np.cross(np.eye(3)[:, np.newaxis], _EDGES).reshape(3, -1)


def touching(corners: Floats, fps: float) -> tuple[Flags, Floats]:
    """Which corners (T, C, 3), m, world, touch the floor (T, C), and their horizontal speed, m/s.

    With hysteresis, in height and in speed, so that noise about a threshold does not count as
    steps. Until a corner is first clearly on the floor or off it, it counts as it does then.
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
    """Where on the floor (..., 2), m, a force would have no moment about a horizontal axis.

    The force (..., 3), N, is that of the floor on the robot, and the moment about the world's
    origin. It is not finite where the force has no vertical part.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        point: Floats = np.stack([-moment[..., 1], moment[..., 0]], axis=-1) / force[..., 2:]
    return point


def beyond_support(points: Floats, corners: Floats, touches: Flags) -> Floats:
    """How far points (T, 2), m, are outside of the convex hull of the corners (T, C, 3) that touch.

    As seen from above; inside it is negative, and says how far the nearest edge is. Of a frame in
    which no corner touches (T, C) it means nothing.
    """
    n_corners = corners.shape[1]
    # A corner that does not touch stands where one that does stands: the hull is the same.
    substitute = np.where(touches, np.arange(n_corners), touches.argmax(axis=1)[:, np.newaxis])
    hull = np.take_along_axis(corners[..., :2], substitute[..., np.newaxis], axis=1)
    seen = np.ascontiguousarray((hull - points[:, np.newaxis]).T)  # (2, C, T), from the point
    pieces = range(0, len(points), _PIECE)
    beyond = [beyond_hull(*seen[..., first : first + _PIECE]) for first in pieces]
    return np.concatenate([np.zeros(0), *beyond])


def beyond_hull(x: Floats, y: Floats) -> Floats:
    """How far the origin (T,) is outside of the convex hulls of corners (C, T); inside negative.

    The distance of a point p from a convex set is the largest n . p - max_c n . c of all directions
    n, which for corners c is that of a normal of a line through two of them, or of p - c.
    """
    i, j = np.triu_indices(len(x), 1)
    along = np.concatenate([y[j] - y[i], x])[:, np.newaxis]
    across = np.concatenate([x[i] - x[j], y])[:, np.newaxis]
    reach = along * x + across * y
    length = np.hypot(along, across)[:, 0]
    ahead = np.maximum(reach.min(axis=1), -reach.max(axis=1))
    ahead = np.divide(ahead, length, out=np.full_like(ahead, np.nan), where=length > 1e-9)
    beyond: Floats = np.fmax.reduce(ahead, initial=-np.inf)
    return beyond


def floor_forces(corners: Floats, touches: Flags, force: Floats, moment: Floats) -> Floats:
    """The forces (T, C, 3), N, world, with which a floor pushes at corners (T, C, 3) that touch it.

    Their sum is a force (T, 3), N, and a moment (T, 3), N·m, about the world's origin, as far as
    can be: each corner pushes within a friction pyramid of four edges, inscribed in the cone of
    `FRICTION`. Of all distributions with the same sum this is the one with the least squared forces
    (non-negative least squares), so that feet that stand alike carry alike.

    Along which edges the floor pushes is found for all frames at once: it is those along which the
    solution for these alone pushes (Newton's method for the dual problem). In the few frames in
    which that goes in circles the method is that of Lawson and Hanson (1974).
    """
    count = np.maximum(touches.sum(axis=1, keepdims=True), 1)
    centre = (touches[..., np.newaxis] * corners).sum(axis=1) / count
    along = np.zeros((*corners.shape[:2], len(_EDGES), 6))  # force and moment of a push of 1 N
    along[..., :3] = _EDGES
    along[..., 3:] = ((corners - centre[:, np.newaxis]) @ _LEVERS).reshape(along[..., 3:].shape)
    along = (along * touches[..., np.newaxis, np.newaxis]).reshape(len(corners), -1, 6)
    asked = np.concatenate([force, moment - np.cross(centre, force)], axis=1)[..., np.newaxis]
    pushes = np.zeros(along.shape[:2])
    used = np.repeat(touches, len(_EDGES), axis=1)
    left = np.flatnonzero(touches.any(axis=1))
    for _ in range(_ROUNDS):
        those, own = along[left], used[left]
        square = those.transpose(0, 2, 1) @ (those * own[..., np.newaxis]) + _EVEN * np.eye(6)
        found = (those @ np.linalg.solve(square, asked[left]))[..., 0]
        pushes[left], used[left] = found, found > 0.0
        left = left[(used[left] != own).any(axis=1)]
    for k in left:
        on = np.repeat(touches[k], len(_EDGES))
        pushes[k, on] = _least_squares(along[k, on].T, asked[k, :, 0])
    pushes = np.maximum(pushes, 0.0).reshape(*corners.shape[:2], len(_EDGES))
    forces: Floats = pushes @ _EDGES
    return forces


def _least_squares(along: Floats, asked: Floats) -> Floats:
    """Pushes (E,) >= 0 whose sum along (6, E) comes nearest to what is asked (6,)."""
    from scipy.optimize import lsq_linear, nnls

    even = np.sqrt(_EVEN) * np.eye(along.shape[1])
    factors, wanted = np.vstack([along, even]), np.append(asked, np.zeros(len(even)))
    pushes: Floats
    try:
        pushes, _ = nnls(factors, wanted)
    except RuntimeError:  # it may go in circles, too, where corners all but coincide
        pushes = lsq_linear(factors, wanted, bounds=(0.0, np.inf)).x
    return pushes


def stretches(flags: Flags) -> NDArray[np.intp]:
    """First index and one after the last index (S, 2) of each stretch of True in (T,)."""
    return np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2)
