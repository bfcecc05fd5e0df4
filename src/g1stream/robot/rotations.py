"""Rotations as unit quaternions in wxyz order, vectorised over leading axes.

A quaternion array has the shape (..., 4), and a vector array (..., 3); leading axes broadcast. q
and -q are the same rotation. Formulas: J. Diebel, "Representing attitude: Euler angles, unit
quaternions, and rotation vectors" (2006), with active rotations (q v q*).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from g1stream.types import Floats

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "UNIT_TOLERANCE",
    "is_unit",
    "quat_conj",
    "quat_from_axis_angle",
    "quat_from_rpy",
    "quat_from_yaw",
    "quat_mul",
    "quat_normalize",
    "quat_rotate",
    "quat_rotate_inverse",
    "quat_to_rpy",
    "rotation_matrices",
    "rotation_vector",
    "sign_continuous",
    "tilt_of",
    "wrap_angle",
    "wxyz_from_xyzw",
    "xyzw_from_wxyz",
    "yaw_of",
]

UNIT_TOLERANCE: Final = 0.05
"""Maximum deviation of a measured quaternion's norm from 1; an IMU sends zeros until ready."""


def is_unit(quats: Floats) -> NDArray[np.bool_]:
    """(...) whether measured quaternions (..., 4) have a norm close to 1."""
    return np.asarray(np.abs(np.linalg.norm(quats, axis=-1) - 1.0) <= UNIT_TOLERANCE)


def _bilinear(table: list[list[int]], n: int) -> Floats:
    """(n*n, n) matrix of a bilinear product; entry t of the table stands for sign(t) e[|t| - 1]."""
    matrix = np.zeros((n, n, n))
    for i, row in enumerate(table):
        for j, entry in enumerate(row):
            if entry:
                matrix[i, j, abs(entry) - 1] = np.sign(entry)
    return matrix.reshape(n * n, n)


# Each product is bilinear, so it is one outer product times a constant matrix. This takes four
# numpy calls instead of thirty for the single components.
_HAMILTON: Final = _bilinear([[1, 2, 3, 4], [2, -1, 4, -3], [3, -4, -1, 2], [4, 3, -2, -1]], 4)
_CROSS: Final = _bilinear([[0, 3, -2], [-3, 0, 1], [2, -1, 0]], 3)
#: From the products q_i q_j (rows) to the elements of the rotation matrix (Diebel, eq. 125).
_MATRIX: Final = np.array(
    [
        [1, 0, 0, 0, 1, 0, 0, 0, 1],  # ww
        [0, 0, 0, 0, 0, -2, 0, 2, 0],  # wx
        [0, 0, 2, 0, 0, 0, -2, 0, 0],  # wy
        [0, -2, 0, 2, 0, 0, 0, 0, 0],  # wz
        [0, 0, 0, 0, 0, 0, 0, 0, 0],
        [1, 0, 0, 0, -1, 0, 0, 0, -1],  # xx
        [0, 2, 0, 2, 0, 0, 0, 0, 0],  # xy
        [0, 0, 2, 0, 0, 0, 2, 0, 0],  # xz
        [0, 0, 0, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0, 0],
        [-1, 0, 0, 0, 1, 0, 0, 0, -1],  # yy
        [0, 0, 0, 0, 0, 2, 0, 2, 0],  # yz
        [0, 0, 0, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 0, 0],
        [-1, 0, 0, 0, -1, 0, 0, 0, 1],  # zz
    ],
    dtype=np.float64,
)


def _product(a: Floats, b: Floats, matrix: Floats) -> Floats:
    outer = a[..., :, None] * b[..., None, :]
    n_pairs, n = matrix.shape
    result: Floats = (outer.reshape(-1, n_pairs) @ matrix).reshape(*outer.shape[:-2], n)
    return result


def quat_mul(a: Floats, b: Floats) -> Floats:
    """Hamilton product (..., 4), which is the rotation `b` followed by `a`."""
    return _product(a, b, _HAMILTON)


def rotation_matrices(quat: Floats) -> Floats:
    """Matrices (3, 3, ...), body to parent, of unit quaternions (4, ...), with components first."""
    quat = np.ascontiguousarray(quat)  # otherwise the larger array of products would be copied
    products = quat[:, None] * quat[None]
    matrices: Floats = _MATRIX.T @ products.reshape(len(_MATRIX), -1)
    return matrices.reshape(3, 3, *quat.shape[1:])


def quat_conj(quat: Floats) -> Floats:
    """Conjugate (..., 4), the inverse of a unit quaternion."""
    conjugate: Floats = quat * np.array([1.0, -1.0, -1.0, -1.0])
    return conjugate


def quat_normalize(quat: Floats) -> Floats:
    """Normalise quaternions (..., 4); a zero quaternion gives NaN."""
    result: Floats = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    return result


def quat_rotate(quat: Floats, vector: Floats) -> Floats:
    """Rotate vectors (..., 3) by unit quaternions (..., 4), from body to parent frame."""
    axis = quat[..., 1:]
    twice = 2.0 * _product(axis, vector, _CROSS)
    turned: Floats = vector + quat[..., :1] * twice + _product(axis, twice, _CROSS)
    return turned


def quat_rotate_inverse(quat: Floats, vector: Floats) -> Floats:
    """Rotate vectors (..., 3) by inverse unit quaternions (..., 4), from parent to body frame."""
    return quat_rotate(quat_conj(quat), vector)


def quat_from_axis_angle(axis: Floats, angle: Floats) -> Floats:
    """Quaternion (..., 4) of a rotation by `angle` (...) rad about the unit `axis` (..., 3)."""
    half = np.asarray(angle)[..., None] / 2
    vector = np.sin(half) * axis
    return np.concatenate([np.broadcast_to(np.cos(half), (*vector.shape[:-1], 1)), vector], axis=-1)


def quat_from_yaw(yaw: Floats | float) -> Floats:
    """Quaternion (..., 4) of a rotation by `yaw` (...) rad about the vertical axis z."""
    return quat_from_axis_angle(np.array([0.0, 0.0, 1.0]), np.asarray(yaw))


def rotation_vector(quat: Floats) -> Floats:
    """Rotation vector (..., 3) rad of a small rotation (..., 4), as twice its vector part."""
    vector: Floats = 2.0 * np.copysign(1.0, quat[..., :1]) * quat[..., 1:]
    return vector


def quat_from_rpy(rpy: Floats) -> Floats:
    """Quaternion (..., 4) of roll, pitch, yaw (..., 3) rad about the fixed x, y, z axes.

    This is the convention of URDF's `rpy` and of LowState's `imu_state.rpy`.
    """
    half = np.asarray(rpy) / 2
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(half), -1, 0), np.moveaxis(np.sin(half), -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def quat_to_rpy(quat_wxyz: NDArray[np.floating]) -> tuple[float, float, float]:
    """Roll, pitch, yaw, rad, of one unit quaternion (4,); the inverse of `quat_from_rpy`.

    Pitch is in [-pi/2, pi/2]. At either end only the sum or the difference of roll and yaw is
    defined, and the result is one of the triples of this rotation. The result is computed from half
    the sum and half the difference of roll and yaw, which is exact there too (E. Bernardes and
    S. Viollet, "Quaternion to Euler angles conversion", 2022). It takes 2 us, because the simulator
    calls it for each LowState.
    """
    w, x, y, z = quat_wxyz.tolist()
    half_sum, half_difference = math.atan2(x + z, w - y), math.atan2(x - z, w + y)
    pitch = 2.0 * math.atan2(math.hypot(x - z, w + y), math.hypot(x + z, w - y)) - math.pi / 2.0
    turn = 2.0 * math.pi
    roll, yaw = half_sum + half_difference, half_sum - half_difference
    return roll - turn * round(roll / turn), pitch, yaw - turn * round(yaw / turn)


def tilt_of(quat_wxyz: NDArray[np.floating]) -> float:
    """Angle between the z axes of body and world, rad, of one unit quaternion (4,).

    The z component of the rotated z axis is 1 - 2 (x^2 + y^2). It takes 1 us, because the loop
    calls it.
    """
    x, y = float(quat_wxyz[1]), float(quat_wxyz[2])
    return math.acos(min(1.0, max(-1.0, 1.0 - 2.0 * (x * x + y * y))))


def yaw_of(quat: Floats) -> Floats:
    """Heading (...) rad in (-pi, pi], the direction of the body's x axis seen from above."""
    w, x, y, z = np.moveaxis(quat, -1, 0)
    heading: Floats = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return heading


def wrap_angle(angle: Floats) -> Floats:
    """Wrap angles, rad, to between -pi and pi."""
    within: Floats = np.arctan2(np.sin(angle), np.cos(angle))
    return within


def wxyz_from_xyzw(quat_xyzw: Floats) -> Floats:
    """Reorder quaternions (..., 4) from xyzw (files, Foxglove, ROS, scipy) to wxyz."""
    return np.roll(quat_xyzw, 1, axis=-1)


def xyzw_from_wxyz(quat_wxyz: Floats) -> Floats:
    """Reorder quaternions (..., 4) from wxyz to xyzw (files, Foxglove, ROS, scipy)."""
    return np.roll(quat_wxyz, -1, axis=-1)


def sign_continuous(quat_wxyz: Floats) -> Floats:
    """Flip quaternions (T, 4) so that each has a non-negative dot product with the previous one."""
    flips = np.einsum("ij,ij->i", quat_wxyz[1:], quat_wxyz[:-1]) < 0
    signs = np.where(np.logical_xor.accumulate(flips), -1.0, 1.0)
    return np.concatenate([quat_wxyz[:1], quat_wxyz[1:] * signs[:, np.newaxis]])
