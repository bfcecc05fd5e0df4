"""A smooth function of time through frames at a constant rate: the pose and its derivatives.

Joints and root position are natural cubic splines through the frames. The orientation of the root
is a rotation vector from each frame to the next that is a cubic in time (K. S. Park and B. Ravani,
"Smooth invariant interpolation of rotations", 1997, as in SciPy's `RotationSpline`). Position,
velocity and acceleration are continuous (C2).

The boundary conditions are natural. This curve has the least curvature of all curves through the
frames, and it starts and ends without acceleration. Its end velocities are those of the first and
last frames, neither extrapolated (not-a-knot) nor forced to zero (clamped). So a motion that starts
at rest stays at rest, and a clip starts with the velocity of the original movement.

All coefficients are in one array, so that a sample is one small matrix product.
"""

from __future__ import annotations

from math import factorial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from g1stream.motion.blend import seam_frames
from g1stream.robot.joints import N_JOINTS
from g1stream.robot.kinematics import BLOCK
from g1stream.robot.rotations import quat_conj, quat_mul

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from g1stream.types import Floats

__all__ = ["REACH", "Spline", "TrajectoryPoint"]

REACH: Final = 32
"""Number of frames on either side that a part of a spline is also fitted through. The influence of
a frame falls by a factor of 3.7 per frame, and is below the precision of float64 beyond 32."""

# The exponential map of rotations and its derivatives need functions such as (1 - cos a) / a**2.
# Power series in a**2 have no special case at 0. The angle between two frames is at most half a
# turn, or slightly more in between, for which 15 terms are exact in float64.
_TERMS: Final = range(15)
_VERSINE: Final = tuple((-1) ** k / factorial(2 * k + 2) for k in _TERMS)  # (1 - cos a) / a**2
_SINE_GAP: Final = tuple((-1) ** k / factorial(2 * k + 3) for k in _TERMS)  # (a - sin a) / a**3
_VERSINE_RATE: Final = tuple(k * c for k, c in enumerate(_VERSINE))[1:]  # its d / d(a**2)
_SINE_GAP_RATE: Final = tuple(k * c for k, c in enumerate(_SINE_GAP))[1:]
_HALF_COS: Final = tuple((-0.25) ** k / factorial(2 * k) for k in _TERMS)  # cos(a / 2)
_HALF_SINC: Final = tuple((-0.25) ** k / factorial(2 * k + 1) / 2 for k in _TERMS)  # sin(a/2) / a


class TrajectoryPoint(NamedTuple):
    """The reference at one time, or at N times. Then every array has N rows.

    Attributes:
        joint_pos: (J,) rad, in the order of the motion's joint names.
        joint_vel: (J,) rad/s.
        joint_acc: (J,) rad/s^2.
        root_pos: (3,) pelvis in the world frame, m.
        root_lin_vel: (3,) in the world frame, m/s.
        root_lin_acc: (3,) in the world frame, m/s^2, without gravity.
        root_quat_wxyz: (4,) pelvis in the world frame, unit. Its sign is continuous, except at the
            restart of a loop that has turned the root by a full turn.
        root_ang_vel: (3,) in the pelvis frame (as a gyroscope measures it), rad/s.
        root_ang_acc: (3,) time derivative of `root_ang_vel`, in the pelvis frame, rad/s^2.
    """

    joint_pos: Floats
    joint_vel: Floats
    joint_acc: Floats
    root_pos: Floats
    root_lin_vel: Floats
    root_lin_acc: Floats
    root_quat_wxyz: Floats
    root_ang_vel: Floats
    root_ang_acc: Floats


class Spline:
    """A spline that can be sampled at any time, in seconds from frame 0.

    Before the first frame and after the last it rests at that frame, without velocity and
    acceleration. With `loop` it repeats without end: after the last frame a seam (see
    `blend.seam_frames`) leads back to frame 0, also C2.

    Args:
        fps: frames per second.
        joint_pos: (T, 29) rad, T >= 2.
        root_pos: (T, 3) m.
        root_quat_wxyz: (T, 4) unit, of continuous sign.
        loop: whether it repeats.

    Attributes:
        fps: as given.
        loop: as given.
        duration: s, from frame 0 to the last frame.
        period: s, from frame 0 to the next frame 0 of a loop: `duration` and the seam; without a
            loop the same as `duration`.
    """

    def __init__(
        self,
        fps: float,
        joint_pos: Floats,
        root_pos: Floats,
        root_quat_wxyz: Floats,
        *,
        loop: bool = False,
    ) -> None:
        self.fps, self.loop = fps, loop
        self.duration = (len(joint_pos) - 1) / fps
        frames = np.asarray(root_quat_wxyz), joint_pos, root_pos
        n_wrap = 0
        if loop:
            n_wrap = REACH
            linear, quat = seam_frames(np.hstack([joint_pos, root_pos]), frames[0], fps)
            around = np.arange(-n_wrap, len(linear) + n_wrap + 1) % len(linear)
            linear, quat = linear[around], quat[around]
            frames = quat, linear[:, :N_JOINTS], linear[:, N_JOINTS:]
        coefficients = _in_parts(_fit, fps, *frames)
        own = slice(n_wrap, len(coefficients) - n_wrap)
        self._coefficients = np.ascontiguousarray(coefficients[own])
        self._quats = np.ascontiguousarray(frames[0][:-1][own])
        self._n_segments = len(self._coefficients)
        self.period = self._n_segments / fps

    def _refit(self, joint_pos: Floats, root_pos: Floats) -> None:
        """Take other joints and root positions, (T, 29) and (T, 3), and keep the orientations."""
        fitted = _in_parts(_fit_linear, self.fps, joint_pos, root_pos)
        self._coefficients = np.concatenate([fitted, self._coefficients[..., -3:]], axis=-1)

    def sample(self, t: float) -> TrajectoryPoint:
        """The reference at time `t`, s. It takes about 20 us, for use in a control loop."""
        inside = t >= 0 if self.loop else 0 <= t <= self.period
        t = t % self.period if self.loop and inside else min(max(t, 0.0), self.period)
        k = min(int(t * self.fps), self._n_segments - 1)
        s = t - k / self.fps
        moving = 1.0 if inside else 0.0
        basis = np.array(
            (
                (s * s * s, s * s, s, 1.0),
                (3.0 * s * s * moving, 2.0 * s * moving, moving, 0.0),
                (6.0 * s * moving, 2.0 * moving, 0.0, 0.0),
            )
        )
        value = basis @ self._coefficients[k]
        rotation = _rotation_state(self._quats[k].tolist(), *value[:, -3:].tolist())
        return self._point(value, *map(np.array, rotation))

    def sample_many(self, times: ArrayLike) -> TrajectoryPoint:
        """The reference at times (N,), s: each array of the result has a row per time."""
        value, k = self._values(times, 3, slice(None))
        rotation = _rotation_state(self._quats[k].T, *np.moveaxis(value[..., -3:], -1, 1))
        return self._point(value, *(np.stack(part, axis=-1) for part in rotation))

    def sample_joints(self, times: ArrayLike) -> tuple[Floats, Floats]:
        """Joint positions, rad, and velocities, rad/s, at times (N,), s: (N, 29) each.

        Same as `sample_many`, in half the time.
        """
        (q, dq), _ = self._values(times, 2, slice(N_JOINTS))
        return q, dq

    def _values(
        self, times: ArrayLike, orders: int, columns: slice
    ) -> tuple[Floats, NDArray[np.intp]]:
        """Columns and their derivatives (orders, N, D) at times (N,), s; segments (N,)."""
        t = np.asarray(times, dtype=np.float64)
        inside = t >= 0 if self.loop else (t >= 0) & (t <= self.period)
        t = np.where(inside & self.loop, t % self.period, np.clip(t, 0.0, self.period))
        k = np.minimum((t * self.fps).astype(np.intp), self._n_segments - 1)
        s, basis = t - k / self.fps, np.zeros((3, 4, len(t)))
        basis[0] = s * s * s, s * s, s, np.ones_like(s)
        basis[1, :3] = np.array((3.0 * s * s, 2.0 * s, np.ones_like(s))) * inside
        basis[2, :2] = np.array((6.0 * s, np.full_like(s, 2.0))) * inside
        rows = np.ascontiguousarray(np.moveaxis(basis[:orders], -1, 0))
        return np.moveaxis(rows @ self._coefficients[k, :, columns], 0, 1), k

    def _point(self, value: Floats, *rotation: Floats) -> TrajectoryPoint:
        joints, root = value[..., :N_JOINTS], value[..., N_JOINTS:-3]
        # By index, because unpacking an array takes 1 us longer in every tick.
        return TrajectoryPoint(
            joints[0], joints[1], joints[2], root[0], root[1], root[2], *rotation
        )


def _in_parts(fit: Callable[..., Floats], fps: float, *frames: Floats) -> Floats:
    """Cubics between frames, coefficients (T - 1, 4, D), the highest power first.

    Args:
        fit: computes the coefficients of some frames, (4, T - 1, D). Many frames at once do not fit
            into the processor's caches.
        fps: frames per second.
        frames: arrays (T, ...) that are passed to `fit`.
    """
    n_segments, cubics = len(frames[0]) - 1, np.empty(0)
    for first in range(0, n_segments, BLOCK):
        lowest = max(0, first - REACH)
        fitted = fit(fps, *(values[lowest : first + BLOCK + REACH + 1] for values in frames))
        part = np.moveaxis(fitted, 0, 1)[first - lowest :][:BLOCK]
        if not first:
            cubics = np.empty((n_segments, *part.shape[1:]))
        cubics[first : first + len(part)] = part
    return cubics


def _fit(fps: float, quat: Floats, *linear: Floats) -> Floats:
    """Cubics between frames: quat wxyz (T, 4), linear (T, ...) -> coefficients (4, T - 1, D + 3).

    The last three columns are the rotation vector from the first frame of the segment, in the axes
    of that frame.
    """
    return np.concatenate([_fit_linear(fps, *linear), _fit_rotation(fps, quat)], axis=-1)


def _fit_linear(fps: float, *linear: Floats) -> Floats:
    """The natural cubics through arrays (T, ...) side by side: coefficients (4, T - 1, D).

    The second derivatives m of a cubic spline with an even step fulfil m[i-1] + 4 m[i] + m[i+1] =
    6 (y[i-1] - 2 y[i] + y[i+1]) / step^2; here they are in units of 1 / step^2.
    """
    values = np.hstack(linear)
    way, bend = np.diff(values, axis=0), np.zeros_like(values)
    n = len(values) - 2
    if n > 0:
        one = np.ones((n, 1, 1))
        solve = _tridiagonal_solver(one, 4.0 * one, one)
        bend[1:-1] = solve(6.0 * np.diff(way, axis=0)[:, np.newaxis])[:, 0]
    slope = way - (2.0 * bend[:-1] + bend[1:]) / 6.0
    cubics = np.stack([np.diff(bend, axis=0) / 6.0, 0.5 * bend[:-1], slope, values[:-1]])
    in_seconds: Floats = cubics * (fps ** np.arange(3, -1, -1))[:, np.newaxis, np.newaxis]
    return in_seconds


#: Most iterations for the rates of a rotation spline, and the final difference of two of them.
_ROUNDS: Final = 20
_NEAR: Final = 1e-13


def _fit_rotation(fps: float, quat: Floats) -> Floats:
    """The cubic rotation vectors between frames (T, 4) wxyz: coefficients (4, T - 1, 3).

    The angular velocities w at the frames make the angular acceleration continuous. Those of the
    first and the last frame are the means of their segments. With a step of 1, the rotations r from
    frame to frame, the right Jacobian J(r) of SO(3), its inverse K(r), and the part n of the
    acceleration that is not linear in w, they fulfil
    J(r[i-1]) w[i-1] + 4 w[i] + K(r[i]) w[i+1] = 3 (r[i-1] + r[i]) - n / 2.
    Because n depends on w, this is solved iteratively.
    """
    turns = _logarithm(quat_mul(quat_conj(quat[:-1]), quat[1:]))
    jacobian = _right_jacobian(turns)
    inverse = np.asarray(np.linalg.inv(jacobian), np.float64)
    rates, n = np.concatenate([turns, turns[-1:]]), len(turns) - 1
    rates[1:-1] = 0.5 * (turns[:-1] + turns[1:])
    ends = np.einsum("nij,nj->ni", inverse, rates[1:])
    wanted = 3.0 * (turns[:-1] + turns[1:])
    four = np.broadcast_to(4.0 * np.eye(3), (n, 3, 3))
    solve = _tridiagonal_solver(jacobian[:-1], four, inverse[1:])
    for _ in range(_ROUNDS if n else 0):
        curved = _rotation_state((1.0, 0.0, 0.0, 0.0), turns[:-1].T, ends[:-1].T, (0.0, 0.0, 0.0))
        right = wanted - 0.5 * np.stack(curved[2], axis=-1)
        right[0] -= jacobian[0] @ rates[0]
        right[-1] -= inverse[-1] @ rates[-1]
        found = solve(right[..., np.newaxis])[..., 0]
        change = np.abs(found - rates[1:-1]).max()
        rates[1:-1] = found
        ends = np.einsum("nij,nj->ni", inverse, rates[1:])
        if change <= _NEAR * (1.0 + np.abs(found).max()):
            break
    starts = rates[:-1]
    cubics = np.stack(
        [starts + ends - 2.0 * turns, 3.0 * turns - 2.0 * starts - ends, starts, 0.0 * turns]
    )
    in_seconds: Floats = cubics * (fps ** np.arange(3, -1, -1))[:, np.newaxis, np.newaxis]
    return in_seconds


def _logarithm(quat: Floats) -> Floats:
    """(N, 3) rotation vectors of quaternions (N, 4) wxyz, rad, of at most half a turn."""
    quat = np.copysign(1.0, quat[:, :1]) * quat
    sine = np.linalg.norm(quat[:, 1:], axis=1, keepdims=True)
    tiny = sine < 1e-8  # the angle is then twice this sine, in float64
    factor = np.where(tiny, 2.0, 2.0 * np.arctan2(sine, quat[:, :1]) / np.where(tiny, 1.0, sine))
    vectors: Floats = factor * quat[:, 1:]
    return vectors


def _right_jacobian(turns: Floats) -> Floats:
    """(N, 3, 3) matrices from the rates of rotation vectors (N, 3) to angular velocities."""
    cross = np.cross(np.eye(3), turns[:, np.newaxis])  # [r]x of each
    angle2 = np.square(turns).sum(axis=1)[:, np.newaxis, np.newaxis]
    jacobian: Floats = (
        np.eye(3) - _series(_VERSINE, angle2) * cross + _series(_SINE_GAP, angle2) * (cross @ cross)
    )
    return jacobian


def _tridiagonal_solver(lower: Floats, middle: Floats, upper: Floats) -> Callable[[Floats], Floats]:
    """Solver of lower[i] x[i-1] + middle[i] x[i] + upper[i] x[i+1] = y[i] for x (N, K, M) given y.

    It uses cyclic reduction. Each step expresses every second unknown by its neighbours, all at
    once, which halves the system. `lower[0]` and `upper[-1]` are not used.

    Args:
        lower: (N, K, K).
        middle: (N, K, K), large compared with the other two.
        upper: (N, K, K).
    """
    if len(middle) <= 1:
        return lambda right: np.asarray(np.linalg.solve(middle, right))
    inverse = np.linalg.inv(middle[1::2])
    before, after = inverse @ lower[1::2], inverse @ upper[1::2]
    n_odd, n = len(inverse), (len(middle) - 1) // 2  # n: odd unknowns between two even ones
    low, high = lower[2::2], upper[:-1:2]
    even_lower, even_middle, even_upper = (np.array(one[::2]) for one in (lower, middle, upper))
    even_lower[1:] = -low @ before[:n]
    even_middle[1:] -= low @ after[:n]
    even_middle[:n_odd] -= high @ before
    even_upper[:n_odd] = -high @ after
    solve_even = _tridiagonal_solver(even_lower, even_middle, even_upper)

    def solve(right: Floats) -> Floats:
        alone, even = inverse @ right[1::2], np.array(right[::2])
        even[1:] -= low @ alone[:n]
        even[:n_odd] -= high @ alone
        x = np.empty_like(right)
        x[::2] = solve_even(even)
        x[1::2] = alone - before @ x[:-1:2]
        x[1::2][:n] -= after[:n] @ x[2::2]
        return x

    return solve


def _rotation_state(base: Any, r: Any, rate: Any, accel: Any) -> tuple[Any, Any, Any]:
    """Orientation base * exp(r), and its angular velocity and acceleration in its own axes.

    Each argument is a sequence of components, floats or arrays (N,): base as a quaternion wxyz, the
    rotation vector r and its first two time derivatives. With x for the cross product,
    A = (1 - cos a) / a^2 and B = (a - sin a) / a^3 of a = |r|, the angular velocity is
    r' - A r x r' + B r x (r x r') (the right Jacobian of SO(3), as in Sola et al., "A micro Lie
    theory", eq. 143); the acceleration is its time derivative.
    """
    angle2 = _dot(r, r)
    a, b = _series(_VERSINE, angle2), _series(_SINE_GAP, angle2)
    growth = 2.0 * _dot(r, rate)
    a_dot, b_dot = growth * _series(_VERSINE_RATE, angle2), growth * _series(_SINE_GAP_RATE, angle2)
    c1 = _cross(r, rate)
    c2 = _cross(r, c1)
    d1 = _cross(r, accel)
    d2 = _cross(r, d1)
    e2 = _cross(rate, c1)
    ang_vel = tuple(rate[i] - a * c1[i] + b * c2[i] for i in range(3))
    ang_acc = tuple(
        accel[i] - a * d1[i] + b * d2[i] - a_dot * c1[i] + b_dot * c2[i] + b * e2[i]
        for i in range(3)
    )
    w, half = _series(_HALF_COS, angle2), _series(_HALF_SINC, angle2)
    x, y, z = half * r[0], half * r[1], half * r[2]
    bw, bx, by, bz = base
    quat = (
        bw * w - bx * x - by * y - bz * z,
        bw * x + bx * w + by * z - bz * y,
        bw * y - bx * z + by * w + bz * x,
        bw * z + bx * y - by * x + bz * w,
    )
    return quat, ang_vel, ang_acc


def _series(coefficients: tuple[float, ...], x: Any) -> Any:
    total = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = total * x + coefficient
    return total


def _dot(u: Any, v: Any) -> Any:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u: Any, v: Any) -> tuple[Any, Any, Any]:
    return (
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    )
