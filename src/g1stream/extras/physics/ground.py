"""Contact of a motion's soles with a flat floor: which corners touch, and the contact forces.

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
"""A lower coefficient for planning, because a floor may have less than usual."""

LIFTED: Final = 0.035
"""Height above which a corner of a sole is off the floor, m."""

#: A corner touches the floor from when it is below both of the first height and speed until it is
#: above one of the second ones, m and m/s. In retargeted clips standing feet are up to 2 cm above
#: the floor and slide at about 0.1 m/s.
_TOUCHES: Final = (0.02, 0.25)
_LEAVES: Final = (LIFTED, 0.5)

#: Frames per block, which fit into a processor's cache.
_PIECE: Final = 256
#: Weight of the squared forces when the contact force is distributed. It is so small that the sum
#: of the forces is right to a millionth, and their moments, with short levers, to a ten-thousandth.
_EVEN: Final = 1e-6
#: Most iterations of Newton's method, which cycles in 140 of 3,500 frames of a dance.
_ROUNDS: Final = 12
#: Edges of the friction pyramid.
_EDGES: Final = np.array(
    [(FRICTION, 0, 1), (-FRICTION, 0, 1), (0, FRICTION, 1), (0, -FRICTION, 1)], dtype=float
)
#: The cross product of a lever (3,) with each edge is the lever times this (3, 12).
_LEVERS: Final = np.cross(np.eye(3)[:, np.newaxis], _EDGES).reshape(3, -1)


def touching(corners: Floats, fps: float) -> tuple[Flags, Floats]:
    """Which corners (T, C, 3), m, world, touch the floor (T, C), and their horizontal speed, m/s.

    Height and speed have hysteresis, so that noise at a threshold does not count as steps. A corner
    has its first clear state, on the floor or off it, also in the frames before.
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
    """The point on the floor (..., 2), m, about which a force has no horizontal moment.

    The force (..., 3), N, is that of the floor on the robot, and the moment is about the world's
    origin. The point is not finite if the force has no vertical component.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        point: Floats = np.stack([-moment[..., 1], moment[..., 0]], axis=-1) / force[..., 2:]
    return point


def beyond_support(points: Floats, corners: Floats, touches: Flags) -> Floats:
    """Distance of points (T, 2), m, outside of the convex hull of the touching corners (T, C, 3).

    Seen from above. Inside it is negative: the distance to the nearest edge. It has no meaning in
    frames without a touching corner (T, C).
    """
    n_corners = corners.shape[1]
    # Corners that do not touch are moved to one that does, which does not change the hull.
    substitute = np.where(touches, np.arange(n_corners), touches.argmax(axis=1)[:, np.newaxis])
    hull = np.take_along_axis(corners[..., :2], substitute[..., np.newaxis], axis=1)
    seen = np.ascontiguousarray((hull - points[:, np.newaxis]).T)  # (2, C, T), from the point
    pieces = range(0, len(points), _PIECE)
    beyond = [beyond_hull(*seen[..., first : first + _PIECE]) for first in pieces]
    return np.concatenate([np.zeros(0), *beyond])


def beyond_hull(x: Floats, y: Floats) -> Floats:
    """Distance of the origin (T,) outside of the convex hulls of corners (C, T); inside negative.

    The distance of a point p from a convex set is the largest n . p - max_c n . c over all
    directions n. For corners c these are the normals of lines through two corners, and the
    directions of p - c.
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
    """The contact forces (T, C, 3), N, world, at the touching corners (T, C, 3) of the soles.

    Their sum is a force (T, 3), N, and a moment (T, 3), N·m, about the world's origin, as far as
    possible. The force at a corner is within a friction pyramid of four edges, inscribed in the
    cone of `FRICTION`. Of all distributions with the same sum it is the one with the least squared
    forces (non-negative least squares), so that symmetric feet share the load equally.

    The active edges are found for all frames at once, by Newton's method for the dual problem. In
    the few frames in which it cycles, the method of Lawson and Hanson (1974) is used.
    """
    count = np.maximum(touches.sum(axis=1, keepdims=True), 1)
    centre = (touches[..., np.newaxis] * corners).sum(axis=1) / count
    along = np.zeros((*corners.shape[:2], len(_EDGES), 6))  # force and moment per newton
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
    """Pushes (E,) >= 0 whose sum along (6, E) is closest to the desired one (6,)."""
    from scipy.optimize import lsq_linear, nnls

    even = np.sqrt(_EVEN) * np.eye(along.shape[1])
    factors, wanted = np.vstack([along, even]), np.append(asked, np.zeros(len(even)))
    pushes: Floats
    try:
        pushes, _ = nnls(factors, wanted)
    except RuntimeError:  # it may also cycle if corners almost coincide
        pushes = lsq_linear(factors, wanted, bounds=(0.0, np.inf)).x
    return pushes


def stretches(flags: Flags) -> NDArray[np.intp]:
    """First index and index after the last (S, 2) of each run of True in (T,)."""
    return np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2)
